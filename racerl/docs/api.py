"""A page for Python: the functions of `racerl.commands` and their results, from their docstrings."""

import ast
from collections.abc import Iterator
from pathlib import Path

from racerl.docs.markdown import fenced

SOURCE = Path(__file__).parents[1] / "commands.py"


def pages() -> dict[str, str]:
    """Return the page, by its place."""
    module = ast.parse(SOURCE.read_text(encoding="utf-8"))
    own = [node for node in module.body if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name[0] != "_"]
    functions = [part for node in own if isinstance(node, ast.FunctionDef) for part in _function(node)]
    classes = [part for node in own if isinstance(node, ast.ClassDef) for part in _class(node)]
    about = ast.get_docstring(module) or ""
    return {"python.md": "\n\n".join(["# From Python", about, "## Functions", *functions, "## Results", *classes])}


def _function(node: ast.FunctionDef) -> Iterator[str]:
    yield f"### {node.name}"
    yield ast.get_docstring(node) or ""
    lines = ",\n    ".join(ast.unparse(node.args).split(", "))
    yield fenced("python", f"def {node.name}(\n    {lines}\n) -> {ast.unparse(node.returns or ast.Constant(None))}")


def _class(node: ast.ClassDef) -> Iterator[str]:
    yield f"### {node.name}"
    yield ast.get_docstring(node) or ""
    fields = [f"- `{ast.unparse(each)}`" for each in node.body if isinstance(each, ast.AnnAssign)]
    known = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name[0] != "_"]
    members = [f"- `{each.name}{_arguments(each)}`: {ast.get_docstring(each)}" for each in known]
    if rows := fields + members:
        yield "\n".join(rows)


def _arguments(node: ast.FunctionDef) -> str:
    """Return what is written behind a member's name: nothing where it is a property."""
    called = any(ast.unparse(each) == "classmethod" for each in node.decorator_list)
    return f"({', '.join(each.arg for each in node.args.args[1:])})" if called else ""
