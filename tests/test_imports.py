"""The picture of the imports in docs/explanation/architecture.md is that of the code."""

from pathlib import Path

import grimp

PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "architecture.md"
BEGIN, END = "<!-- imports: begin -->\n", "<!-- imports: end -->"
ROOT = "mobilecal_cli"
#: Packages whose parts are drawn apart.
OPENED = (f"{ROOT}.readers",)


def picture() -> str:
    """Who imports whom, one line for each package or module that imports others, top layer first."""
    graph = grimp.build_graph(ROOT, include_external_packages=False)

    def node(module: str) -> str:
        for package in OPENED:
            if module.startswith(f"{package}."):
                return ".".join(module.split(".")[1:3])
        return module.split(".")[1] if "." in module else ""

    edges: dict[str, set[str]] = {}
    for module in sorted(graph.modules):
        names = {node(other) for other in graph.find_modules_directly_imported_by(module)}
        edges.setdefault(node(module), set()).update(names - {node(module), ""})
    edges.pop("", None)
    depth: dict[str, int] = {}

    def below(name: str) -> int:
        if name not in depth:
            depth[name] = 0  # of a cycle, which import-linter refuses
            depth[name] = 1 + max(map(below, edges.get(name, ())), default=-1)
        return depth[name]

    lines = [
        f"{name:26} ─▶ {', '.join(sorted(targets, key=lambda target: (-below(target), target)))}"
        for name, targets in sorted(edges.items(), key=lambda edge: (-below(edge[0]), edge[0]))
        if targets
    ]
    return "\n".join(["```", *lines, "```"]) + "\n"


def test_the_picture_of_the_imports_is_that_of_the_code():
    page = PAGE.read_text()
    drawn = page[page.index(BEGIN) + len(BEGIN) : page.index(END)]
    assert drawn == picture(), f"replace it with:\n{picture()}"
