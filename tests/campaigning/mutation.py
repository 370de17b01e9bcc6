"""Values changed at random: what a configuration, a record or a command line could be given."""

import copy
import json
import math
import random
from typing import Any

NUMBERS = (
    0, -1, 1, 2, 0.5, -0.5, 1e308, -1e308, 1e-308, 5e-324, 1e39, 1e30, 1e9, 3e-9, -0.0, 2**31,
    2**53, 2**63 - 1, 2**63, -(2**63), 10**30, 10**400, 99999, math.nan, math.inf, -math.inf,
)  # fmt: skip

TEXTS = (
    "", " ", "x", "nan", "a" * 70_000, "../../x", "/etc/passwd", "/dev/zero", "\0", "a\nb",
    "é" * 300, "\x1b[31m", "%s%n{0}", "imagenet", "smoke", "none.png", "~", ".", "\u202e",
    "x" * 300,
)  # fmt: skip

SMALL: tuple[Any, ...] = ([], {}, [[]], [1], [1, 2, 3], {"a": 1}, True, False, [None][:0], "", 0)


def strange(rng: random.Random, schema: dict | None = None) -> Any:
    """Draw a value: of the right type and out of range, or of another type."""
    kind = (schema or {}).get("type") if rng.random() < 0.6 else None
    if kind == "number" or (kind is None and rng.random() < 0.4):
        return rng.choice(NUMBERS)
    if kind == "integer":
        return rng.choice([n for n in NUMBERS if isinstance(n, int)])
    if kind == "string" or (kind is None and rng.random() < 0.4):
        return rng.choice(TEXTS)
    if kind == "array":
        inner = (schema or {}).get("prefixItems") or [(schema or {}).get("items") or {}]
        count = rng.choice((0, 1, 2, 2, 2, 3, 2000))
        return [strange(rng, rng.choice(inner)) for _ in range(count)]
    return copy.deepcopy(rng.choice(SMALL))


def resolved(schema: dict, root: dict) -> dict:
    """Follow references, and take the first object among alternatives."""
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    for some in schema.get("anyOf", ()):
        found = resolved(some, root)
        if found.get("type") in ("object", "array"):
            return found
    return resolved(schema["anyOf"][0], root) if "anyOf" in schema else schema


def changed(values: Any, rng: random.Random, schema: dict | None = None) -> Any:
    """Change a value somewhere inside, once to three times; the original stays."""
    values = json.loads(json.dumps(values))
    holder = {"": values}
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        _change_once(holder, rng, schema or {})
    return holder[""]


def _change_once(holder: dict, rng: random.Random, schema: dict) -> None:
    places = list(_places(holder[""], schema, schema))
    if not places:
        return
    where, key, inner = rng.choice(places)
    if isinstance(where, dict) and rng.random() < 0.25:
        known = resolved(inner["parent"], schema).get("properties", {})
        new = rng.choice([*known, rng.choice(TEXTS[2:5] + TEXTS[8:11])])
        where[new] = strange(rng, resolved(known.get(new, {}), schema))
    elif rng.random() < 0.15:
        del where[key]
    elif isinstance(where, list) and rng.random() < 0.1:
        where.extend(where * rng.choice((1, 50)))
    else:
        where[key] = strange(rng, inner["own"])


def _places(value: Any, schema: dict, root: dict):
    """List all places in a value: what holds it, its key there, and the schemas of both."""
    schema = resolved(schema, root)
    if isinstance(value, dict):
        known, other = schema.get("properties", {}), schema.get("additionalProperties")
        for key, inside in value.items():
            own = resolved(known.get(key) or (other if isinstance(other, dict) else {}), root)
            yield value, key, {"own": own, "parent": schema}
            yield from _places(inside, own, root)
    elif isinstance(value, list):
        items = schema.get("prefixItems") or [schema.get("items") or {}]
        for key, inside in enumerate(value):
            own = resolved(items[min(key, len(items) - 1)], root)
            yield value, key, {"own": own, "parent": schema}
            yield from _places(inside, own, root)


def changes(new: Any, old: Any, name: str = "") -> list[str]:
    """List what is not as it was, by the names that lead there."""
    if isinstance(new, dict) and isinstance(old, dict):
        gone = [f"no {name}{key}" for key in old.keys() - new.keys()]
        return gone + [
            line for key in new for line in changes(new[key], old.get(key), f"{name}{key}.")
        ]
    if isinstance(new, list) and isinstance(old, list) and len(new) == len(old):
        pairs = enumerate(zip(new, old, strict=True))
        return [line for key, pair in pairs for line in changes(*pair, f"{name}{key}.")]
    same = type(new) is type(old) and new == old
    return [] if same else [f"{name.rstrip('.')} = {new!r}"]


def as_toml(value: Any, top: bool = True) -> str:
    """Write values as TOML, tables within others in one line."""
    if isinstance(value, dict):
        lines = [f"{json.dumps(key)} = {as_toml(inside, False)}" for key, inside in value.items()]
        return "\n".join(lines) + "\n" if top else f"{{{', '.join(lines)}}}"
    if isinstance(value, list):
        return f"[{', '.join(as_toml(inside, False) for inside in value)}]"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return '""' if value is None else json.dumps(value)
