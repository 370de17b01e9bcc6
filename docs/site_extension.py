"""Parts of the documentation site that are made from the program: reference, commands, links."""

import importlib
import inspect
import os
import re
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxTranslator

from lf_flame.commands.cli import commands

ROOT = Path(__file__).parents[1]
GENERATED = ROOT / "docs" / "generated"
ROOMS = sorted(path.parent.name for path in (ROOT / "lf_flame").glob("[a-z]*/__init__.pyi"))
PACKAGES = ("lf_flame", *(f"lf_flame.{room}" for room in ROOMS))


def public_names(package: str) -> dict[str, str]:
    """Public names of a package with the module of each, from its face, in the face's order."""
    face = ROOT / package.replace(".", "/") / "__init__.pyi"
    found = re.findall(r"^from (\.\S+) import (\w+) as", face.read_text("utf-8"), re.MULTILINE)
    return {name: package + module for module, name in found}


def _write(path: Path, text: str) -> None:
    """Write a page if it changed, so that Sphinx reads again only what did."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def write_reference(app: Sphinx) -> None:
    """Write a page for each package, and the page of all commands; former pages go."""
    for page in (GENERATED / "reference").glob("*.rst"):
        if page.stem not in (*PACKAGES, "commands"):
            page.unlink()
    for package in PACKAGES:
        _write(GENERATED / "reference" / f"{package}.rst", _package_page(package))
    _write(GENERATED / "reference" / "commands.rst", _commands_page())


def _package_page(package: str) -> str:
    module = importlib.import_module(package)
    lines = [package, "=" * len(package), "", f".. py:module:: {package}", ""]
    lines += [inspect.getdoc(module) or "", ""]
    elsewhere = []
    for name, origin in public_names(package).items():
        found = getattr(module, name)
        if (home := _home(package, name)) != package:
            elsewhere += [f"- `{home}.{name}`"]
        elif inspect.isclass(found) or callable(found):
            kind = "class" if inspect.isclass(found) else "function"
            lines += [f".. auto{kind}:: {package}.{name}", "   :members:" * (kind == "class"), ""]
        else:
            text = ModuleAnalyzer.for_module(origin).find_attr_docs().get(("", name), [])
            lines += [f".. py:data:: {name}", "", *(f"   {line}" for line in text), ""]
    return "\n".join([*lines, *elsewhere, ""])


def _home(package: str, name: str) -> str:
    """Package whose page describes a name of `lf_flame` itself: the lower one that has it too."""
    if package == "lf_flame":
        for room in ROOMS:
            if name in public_names(f"lf_flame.{room}"):
                return f"lf_flame.{room}"
    return package


def _commands_page() -> str:
    lines = ["Commands", "========", "", "What ``lf-flame COMMAND --help-all`` prints.", ""]
    context = commands.make_context("lf-flame", [], resilient_parsing=True)
    for name, command in commands.commands.items():
        if command.hidden:
            continue
        own = type(context)(command, parent=context, info_name=name, terminal_width=92)
        shown = command.get_whole_help(own)
        lines += [f".. _command-{name}:", "", name, "-" * len(name), "", ".. code-block:: text", ""]
        lines += [f"   {line}" for line in shown.splitlines()] + [""]
    return "\n".join(lines) + "\n"


class RepositoryLinks(SphinxTransform):
    """Links of Markdown pages that Sphinx alone would not follow.

    A link to a folder leads to its README; where it has none, its text stays. A link to a module,
    with a public function or class as its text, leads to the reference.
    """

    default_priority = 5

    def apply(self) -> None:
        """Change the links of one page."""
        page = Path(self.env.doc2path(self.env.docname))
        for link in [*self.document.findall(nodes.Element)]:
            if not isinstance(link, (addnodes.download_reference, addnodes.pending_xref)):
                continue
            target = Path(os.path.normpath(page.parent / link["reftarget"]))
            readme = (target / "README").relative_to(ROOT) if target.is_dir() else None
            if readme and readme.as_posix() in self.env.found_docs:
                link.replace_self(self._reference("std", "doc", f"/{readme}", link.children))
            elif readme:
                link.replace_self(nodes.inline("", "", *link.children))
            elif public := _public_place(target, link.astext()):
                link.replace_self(self._reference("py", "obj", public, link.children))

    def _reference(self, domain: str, kind: str, target: str, text: list) -> addnodes.pending_xref:
        return addnodes.pending_xref(
            "", *text, refdomain=domain, reftype=kind, reftarget=target,
            refdoc=self.env.docname, refexplicit=True, refwarn=True,
        )  # fmt: skip


def _public_place(module: Path, name: str) -> str | None:
    """Full public name of a function, class or method of a module of the package, or None."""
    if not module.is_relative_to(ROOT / "lf_flame"):
        return None
    package = ".".join(["lf_flame", *module.relative_to(ROOT / "lf_flame").parts[:-1][:1]])
    known = package in PACKAGES and name.partition(".")[0] in public_names(package)
    return f"{package}.{name}" if known else None


def _mathml(self: SphinxTranslator, node: nodes.math, block: bool) -> None:
    """Write a formula as MathML, which browsers draw without a script."""
    self.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


ACCESSIBLE = {
    # A table that is wider than a phone scrolls, by the keyboard too.
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    'role="heading">': 'role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="This page">',
    "<pre>": '<pre tabindex="0">',
    'display="block">': 'display="block" tabindex="0">',
}
"""Changes to the pages of theme and Sphinx for keyboards and screen readers."""


def make_accessible(app: Sphinx, error: Exception | None) -> None:
    """Mend the pages that were written."""
    for page in Path(app.outdir).glob("**/*.html") if error is None else ():
        text = before = page.read_text(encoding="utf-8")
        for written, needed in ACCESSIBLE.items():
            text = text.replace(written, needed)
        if text != before:
            page.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict:
    """Register the parts."""
    app.connect("builder-inited", write_reference)
    app.connect("build-finished", make_accessible)
    app.add_transform(RepositoryLinks)
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda self, node: _mathml(self, node, block=False), None),
        block_renderers=(lambda self, node: _mathml(self, node, block=True), None),
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
