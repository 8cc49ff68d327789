"""Run the cells of examples/notebook.ipynb in this process, and keep what they show.

    .venv/bin/python docs/make_notebook.py

Needs no Jupyter: the last line of a cell is shown as a notebook shows it.
"""

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[1] / "examples" / "notebook.ipynb"


def main() -> None:
    """Write the notebook with its outputs."""
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    fill(notebook)
    text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8", newline="\n")


def fill(notebook: dict[str, Any]) -> dict[str, Any]:
    """Run the cells of code of a notebook one after the other; return the names they made."""
    names: dict[str, Any] = {}
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, start=1):
        cell["execution_count"] = number
        cell["outputs"] = run_cell("".join(cell["source"]), names, number)
    return names


def run_cell(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Return what a cell shows, as nbformat 4 has it."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        lines = printed.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines})
    if value is not None:
        shown = {"output_type": "execute_result", "execution_count": number, "metadata": {}}
        outputs.append(shown | {"data": show(value)})
    return outputs


def show(value: Any) -> dict[str, Any]:
    """Return a value in the kinds of content that notebooks choose from."""
    if hasattr(value, "to_plotly_json"):
        return {"application/vnd.plotly.v1+json": json.loads(value.to_json())}
    html = {"text/html": [value._repr_html_()]} if hasattr(value, "_repr_html_") else {}
    return {"text/plain": repr(value).splitlines(keepends=True), **html}


if __name__ == "__main__":
    main()
