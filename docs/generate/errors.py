"""Error catalog from the code: `python docs/generate/errors.py` writes docs/validation/errors.md.

The script finds all places that raise a documented error in the syntax trees of the package. Values that a message
fills in are shown in ⟨⟩.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mobilecal_cli import errors

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "mobilecal_cli"
TARGET = REPOSITORY / "docs" / "validation" / "errors.md"
KINDS: dict[str, type[errors.MobilecalError]] = {
    name: kind
    for name, kind in inspect.getmembers(errors, inspect.isclass)
    if issubclass(kind, errors.MobilecalError) and kind is not errors.MobilecalError
}
HEAD = """\
# Errors

Generated from the code by `make docs`. There are seven kinds of errors, each with its own exit code.
Anything else (exit code 1 and a Python traceback) is a bug in mobilecal. The first line on standard
error is the message, and the second line says what to do. Values that a message fills in are shown
in ⟨⟩.

Ctrl-C, SIGTERM and SIGHUP end a command with exit code 130, 143 and 129. Temporary files are removed,
and the last line says what was written. A closed pipe ends a command with 141. What a killed command
left behind is removed by the next run with the same output.
"""


@dataclass(frozen=True, order=True)
class Entry:
    """One place that raises: its module, the message and the cure."""

    module: str
    message: str
    cure: str


def _filled(node: ast.expr | None, names: dict[str, ast.expr]) -> str:
    """A text as the code builds it, with the values it fills in between ⟨ and ⟩."""
    if node is None:
        return ""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_filled(part, names) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        inner = node.value
        if isinstance(inner, ast.Name) and isinstance(names.get(inner.id), (ast.JoinedStr, ast.Constant)):
            return _filled(names[inner.id], names)
        return f"⟨{_short(inner)}⟩"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _filled(node.left, names) + _filled(node.right, names)
    if isinstance(node, ast.IfExp):
        return _filled(node.body, names) or _filled(node.orelse, names)
    if isinstance(node, ast.Name) and node.id in names:
        return _filled(names[node.id], {})
    return f"⟨{_short(node)}⟩"


def _short(node: ast.expr) -> str:
    """A name for an expression: its last descriptive word."""
    if isinstance(node, ast.Attribute):
        return node.attr.strip("_").replace("_", " ")
    if isinstance(node, ast.Name):
        return node.id.strip("_").replace("_", " ")
    if isinstance(node, ast.Call):
        plain = [
            part for part in node.args if isinstance(part, (ast.Name, ast.Attribute, ast.Call, ast.Subscript))
        ]
        if isinstance(node.func, ast.Attribute) and not plain:
            return _short(node.func.value)
        return _short(plain[0]) if plain else _short(node.func)
    if isinstance(node, (ast.Subscript, ast.Starred)):
        return _short(node.value)
    if isinstance(node, ast.BinOp):
        return _short(node.right if isinstance(node.left, ast.Constant) else node.left)
    if isinstance(node, (ast.GeneratorExp, ast.ListComp)):
        return _short(node.generators[0].iter)
    if isinstance(node, ast.BoolOp):
        return _short(node.values[0])
    return "…"


def _constants(tree: ast.AST) -> dict[str, ast.expr]:
    """Names that are assigned a text."""
    found: dict[str, ast.expr] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            value = node.value
            if isinstance(value, ast.JoinedStr) or (
                isinstance(value, ast.Constant) and isinstance(value.value, str)
            ):
                found[node.targets[0].id] = node.value
    return found


def _raised(path: Path) -> Iterator[tuple[str, Entry]]:
    text = path.read_text(encoding="utf-8")
    if not any(f"{name}(" in text for name in KINDS):
        return
    tree = ast.parse(text)
    top = _constants(tree)
    module = path.relative_to(PACKAGE).with_suffix("").as_posix()
    functions = [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
    seen: set[int] = set()
    for scope in [*reversed(functions), tree]:
        names = top | _constants(scope)
        for node in ast.walk(scope):
            if not isinstance(node, ast.Call) or id(node) in seen or not isinstance(node.func, ast.Name):
                continue
            if node.func.id in KINDS and node.args:
                seen.add(id(node))
                message = " ".join(_filled(node.args[0], names).split())
                cure = " ".join(_filled(node.args[1] if len(node.args) > 1 else None, names).split())
                yield node.func.id, Entry(module, message, cure)


def catalogue() -> str:
    """The text of docs/validation/errors.md."""
    found: dict[str, set[Entry]] = {name: set() for name in KINDS}
    for path in sorted(PACKAGE.rglob("*.py")):
        for kind, entry in _raised(path):
            if any(character.isalpha() for character in _outside(entry.message)):
                found[kind].add(entry)
    parts = [HEAD]
    for name, kind in sorted(KINDS.items(), key=lambda item: item[1].exit_code):
        parts.append(f"\n## `{kind.code}`: exit code {kind.exit_code}\n\n{inspect.getdoc(kind)}\n\n")
        parts.append("| raised in | message | what to do |\n| --- | --- | --- |\n")
        parts += [
            f"| `{entry.module}` | {_cell(entry.message)} | {_cell(entry.cure)} |\n"
            for entry in sorted(found[name])
        ]
    return "".join(parts)


def _outside(message: str) -> str:
    """The fixed text of a message, without the values it fills in."""
    text, depth = "", 0
    for character in message:
        depth += (character == "⟨") - (character == "⟩")
        text += character if depth == 0 else ""
    return text


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "\\<").replace("*", "\\*")


if __name__ == "__main__":
    TARGET.write_text(catalogue(), encoding="utf-8")
    print(f"written: {TARGET.relative_to(REPOSITORY)}", file=sys.stderr)
