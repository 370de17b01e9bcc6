"""Small errors in a program, one at a time: a sign, a factor, a bound, an index, a number.

Each mutant is a replacement in the text, so that lines keep their numbers and their layout. What
no test could be asked to notice is left alone: texts, type hints, error messages.
"""

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass

OPERATORS = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
"""Each operator as it is written, and what takes its place."""

PAIRS = (
    ("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("sin", "cos"),
    ("floor", "ceil"),
)  # fmt: skip
FUNCTIONS = dict(PAIRS) | {other: name for name, other in PAIRS}
"""Functions that take each other's place, whatever module they are of."""

FOR_PEOPLE = ("__repr__", "__str__", "describe")
"""Methods that make texts."""

IMPOSSIBLE = "(1 // 0)"
"""What raises an error where it is worked out."""


@dataclass(frozen=True)
class Mutant:
    """A replacement in a program's text.

    Attributes
    ----------
    file : str
        Path from the root of the checkout.
    line : int
        Of the replaced text's start, counted from 1.
    kind : str
        What sort of error this is.
    start, end : int
        The replaced bytes of the program in UTF-8.
    after : str
        What takes their place.
    whole : (int, int)
        Bytes of the expression that comes out wrong.
    """

    file: str
    line: int
    kind: str
    start: int
    end: int
    after: str
    whole: tuple[int, int]

    def apply(self, source: str) -> str:
        """Plant the error."""
        return _replaced(source, self.start, self.end, self.after)

    def sabotage(self, source: str) -> str:
        """Raise an error where the expression is worked out, to see whether it ever is."""
        return _replaced(source, *self.whole, IMPOSSIBLE)

    def lines(self, source: str) -> tuple[str, str]:
        """Line before and after; of a replacement over several lines, the first one after."""
        before, after = (text.splitlines() for text in (source, self.apply(source)))
        return before[self.line - 1].strip(), after[self.line - 1].strip()


def _replaced(source: str, start: int, end: int, text: str) -> str:
    code = source.encode()
    return (code[:start] + text.encode() + code[end:]).decode()


def find_mutants(source: str, file: str, line: str | None = None) -> list[Mutant]:
    """Find every error that can be planted in a program, in the order of its text.

    Parameters
    ----------
    source : str
    file : str
        Its path, for the record.
    line : str, optional
        Only on lines that read so, but for the spaces around. Default: on all.

    Returns
    -------
    list of Mutant
        Each is a program that can be compiled, and another one.
    """
    tree = ast.parse(source)
    found = sorted(_Finder(source, file).walk(tree), key=lambda m: (m.start, m.end, m.after))
    lines, same = [text.strip() for text in source.splitlines()], ast.dump(tree)
    wanted = (m for m in dict.fromkeys(found) if line in (None, lines[m.line - 1]))
    return [m for m in wanted if _is_another_program(m.apply(source), same)]


def _is_another_program(changed: str, same: str) -> bool:
    try:
        return ast.dump(ast.parse(changed)) != same
    except SyntaxError:
        return False


def draw_mutants(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """Draw some mutants of a file at random, of all kinds in turn; the same for the same seed."""
    if not mutants:
        return []
    rng = random.Random(f"{seed} {mutants[0].file}")
    kinds: dict[str, list[Mutant]] = {}
    for mutant in rng.sample(mutants, len(mutants)):
        kinds.setdefault(mutant.kind, []).append(mutant)
    drawn: list[Mutant] = []
    while len(drawn) < min(count, len(mutants)):
        drawn += [some.pop() for some in kinds.values() if some]
    return sorted(drawn[:count], key=lambda m: (m.start, m.end, m.after))


class _Finder:
    """Walk through a program and make the mutants of each expression."""

    def __init__(self, source: str, file: str):
        self.code = source.encode()
        self.file = file
        self.starts = [0]
        for line in self.code.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def walk(self, node: ast.AST, at_module: bool = True, index: bool = False) -> Iterator[Mutant]:
        """Yield the mutants of a node and of what is in it.

        Parameters
        ----------
        node : ast.AST
        at_module : bool
            Whether it is outside all functions and classes.
        index : bool
            Whether it is part of an index.
        """
        if _is_left_alone(node):
            return
        yield from self._mutants(node, at_module, index)
        inner = isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Lambda))
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            within = isinstance(node, ast.Subscript) and name == "slice"
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    deeper = within or (index and isinstance(node, (ast.Tuple, ast.Slice)))
                    yield from self.walk(child, at_module and not inner, deeper)

    def _mutants(self, node: ast.AST, at_module: bool, index: bool) -> Iterator[Mutant]:
        match node:
            case ast.BinOp(left=left, op=op, right=right):
                yield from self._other_operator(node, op, left, right)
                yield from self._dropped(node)
            case ast.AugAssign(target=target, op=op, value=value):
                yield from self._other_operator(node, op, target, value, value)
            case ast.Compare(left=left, ops=ops, comparators=others):
                for op, one, other in zip(ops, [left, *others], others, strict=False):
                    yield from self._other_operator(node, op, one, other)
            case ast.BoolOp(op=op, values=values):
                for one, other in zip(values, values[1:], strict=False):
                    yield from self._other_operator(node, op, one, other)
            case ast.UnaryOp(op=ast.USub() | ast.Not() as op, operand=operand):
                kind = "sign" if isinstance(op, ast.USub) else "negation"
                yield self._mutant(node, kind, self._text(operand))
            case ast.Call(func=ast.Name(id=name) as func) if name in FUNCTIONS:
                yield self._mutant(func, "function", FUNCTIONS[name], whole=node)
            case ast.Call(func=ast.Attribute(attr=name) as func) if name in FUNCTIONS:
                after = f"{self._text(func.value)}.{FUNCTIONS[name]}"
                yield self._mutant(func, "function", after, whole=node)
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                kind = "index" if index else "module constant" if at_module else "constant"
                for number in _other_numbers(value, index):
                    yield self._mutant(node, kind, repr(number))

    def _other_operator(self, node, op, left, right, whole=None) -> Iterator[Mutant]:
        """Exchange the operator that stands between two expressions."""
        if type(op) not in OPERATORS:
            return
        written, other = OPERATORS[type(op)]
        start, end = self._span(left)[1], self._span(right)[0]
        between = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), self.code[start:end])
        at = start + between.index(written.encode())
        line = 1 + self.code[:at].count(b"\n")
        kind = {ast.BoolOp: "logic", ast.Compare: "comparison"}.get(type(node), "operator")
        span = self._span(whole or node)
        yield Mutant(self.file, line, kind, at, at + len(written), other, span)

    def _dropped(self, node: ast.BinOp) -> Iterator[Mutant]:
        """Drop a term or a factor."""
        kept = {ast.Add: (node.left, node.right), ast.Mult: (node.left, node.right)}
        kept |= {ast.Sub: (node.left,), ast.Div: (node.left,)}
        kind = "term" if isinstance(node.op, (ast.Add, ast.Sub)) else "factor"
        for part in kept.get(type(node.op), ()):
            yield self._mutant(node, kind, self._text(part))

    def _mutant(self, node: ast.AST, kind: str, after: str, whole: ast.AST | None = None) -> Mutant:
        start, end = self._span(node)
        return Mutant(self.file, node.lineno, kind, start, end, after, self._span(whole or node))

    def _span(self, node: ast.AST) -> tuple[int, int]:
        return (
            self.starts[node.lineno - 1] + node.col_offset,
            self.starts[node.end_lineno - 1] + node.end_col_offset,
        )

    def _text(self, node: ast.AST) -> str:
        """Text of an expression, in brackets where it needs some elsewhere."""
        start, end = self._span(node)
        text = self.code[start:end].decode()
        simple = (ast.Name, ast.Constant, ast.Call, ast.Attribute, ast.Subscript)
        return text if isinstance(node, simple) else f"({text})"


def _is_left_alone(node: ast.AST) -> bool:
    """Whether a node is for people, or for the checker of types."""
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.FunctionDef(name=name):
            return name in FOR_PEOPLE
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name.endswith(("Error", "Warning")) or name == "warn"
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
    return False


def _other_numbers(value: float, index: bool) -> tuple[float, ...]:
    """Numbers near one: 0 and 1 exchanged in an index, else one more, 1 % more, twice as much."""
    if isinstance(value, int):
        return (0,) if index and value == 1 else (value + 1,)
    return (1.0,) if value == 0 else (float(f"{1.01 * value:.12g}"), 2 * value)
