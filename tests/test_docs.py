"""The documentation: generated pages are up to date, links lead somewhere, the pages build."""

import importlib.util
import re
import sys

import pytest
import yaml

from mobilecal_cli import errors
from mobilecal_cli.__main__ import help_file
from mobilecal_cli.export.extraction import SCHEMA_VERSION
from mobilecal_cli.export.params import SCHEMA_VERSIONS
from mobilecal_cli.likelihood.constants import KINDS
from tests.command import python
from tests.conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
SECTIONS = ("tutorial", "how-to", "explanation", "reference", "validation")


def generator_of(name):
    spec = importlib.util.spec_from_file_location(f"generate_{name}", DOCS / "generate" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "made"), [("errors", "catalogue"), ("options", "page"), ("schema", "schema")]
)
def test_what_is_generated_is_up_to_date(name, made):
    generator = generator_of(name)
    assert generator.TARGET.read_text(encoding="utf-8") == getattr(generator, made)(), "run: make docs"


def test_every_error_has_its_own_code_and_exit_code_and_says_what_to_do():
    """Except for errors of the readers about a single image, which become rejections with their own cure."""
    generator = generator_of("errors")
    kinds = generator.KINDS.values()
    assert len({kind.code for kind in kinds}) == len({kind.exit_code for kind in kinds}) == 7
    assert {kind.exit_code for kind in kinds} == {2, 3, 4, 5, 6, 7, 8}
    assert issubclass(errors.QualityError, errors.MobilecalError)
    page = generator.TARGET.read_text(encoding="utf-8")
    lines = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")]
    without = {module.removeprefix("| ").strip("`") for module, _, cure in lines if cure in ("|", " |")}
    assert without == {"readers/pictures"}


def test_the_overview_of_the_commands_is_up_to_date():
    assert help_file().read_text(encoding="utf-8") == generator_of("options").overview(), "run: make docs"


def test_the_tables_of_formats_and_robots_are_up_to_date():
    options = generator_of("options")
    page = options.COMMANDS.read_text(encoding="utf-8")
    assert page == options.with_tables(page), "run: make docs"
    assert all(f"| `{name}` |" in page for name in ("urdf", "json"))
    assert "`--robot paper\\|tick\\|" in page


def test_the_stated_schema_version_of_an_extraction_is_that_of_the_code():
    text = (DOCS / "reference" / "recordings.md").read_text(encoding="utf-8")
    assert int(re.search(r"its schema version\s\((\d+)\)", text).group(1)) == SCHEMA_VERSION


def test_the_stated_schema_versions_of_params_yaml_are_those_of_the_code():
    text = (DOCS / "reference" / "params-yaml.md").read_text(encoding="utf-8")
    assert re.findall(r"(\d) for a file with `(\w+)`", text) == [
        (str(number), section) for section, number in SCHEMA_VERSIONS.items()
    ]
    assert re.search(r"^schema_version: (\d) +# (\d):", text, re.MULTILINE).groups() == tuple(
        map(str, SCHEMA_VERSIONS.values())
    )


def test_the_table_of_priors_is_that_of_the_code():
    text = (DOCS / "reference" / "rig-yaml.md").read_text(encoding="utf-8")
    table = text[text.index("| kind | unit | default |") :].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:4]] for line in table.splitlines()[2:]]
    stated = {name.strip("`"): (unit.split(",")[0], float(default)) for name, unit, default in rows}
    assert stated == {kind.name: (kind.shown_unit, pytest.approx(kind.sigma * kind.shown)) for kind in KINDS}


PAGES = sorted(
    path
    for root in (REPOSITORY, REPOSITORY / "sample_logs", *(DOCS / name for name in ("", *SECTIONS)))
    for path in root.glob("*.md")
)


def anchors_of(path):
    """Anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ +(.*?) *$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_every_relative_link_leads_to_a_file_and_an_anchor(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link


def test_the_readme_links_to_every_page_for_users():
    linked = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    pages = {path.relative_to(REPOSITORY).as_posix() for path in PAGES if path.parent != REPOSITORY}
    # The command-line page links to the options; the others are for the documentation's own site.
    others = {f"docs/{name}.md" for name in ("index", "reference/options", "reference/python-api")}
    # One summary links to the pages with all figures.
    figures = {page for page in pages if page.startswith("docs/validation/")} - {"docs/validation/index.md"}
    summary = (DOCS / "validation" / "index.md").read_text(encoding="utf-8")
    assert {page for page in figures if f"({page.rpartition('/')[2]}" not in summary} == set()
    assert {page for page in pages if f"({page})" not in linked} == others | figures


@pytest.mark.long
def test_the_pages_are_built_without_a_warning(tmp_path):
    done = python("-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", DOCS, tmp_path / "html")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert (tmp_path / "html" / "tutorial" / "first-calibration.html").is_file()


def test_every_installation_is_from_the_source():
    """The package is on no index: an image or a workflow that names one would install something else, or nothing."""
    for page in (*DOCS.rglob("*.md"), DOCS / "how-to" / "Dockerfile", DOCS / "how-to" / "github-actions.yml"):
        for arguments in re.findall(r"pip install ([^\n`]*)", page.read_text(encoding="utf-8")):
            (target, *_) = [word.strip("'\"") for word in arguments.split() if not word.startswith("-")]
            assert target.startswith((".", "/source")), f"{page.name}: {arguments}"


def test_the_workflow_and_the_image_name_commands_and_files_that_exist():
    workflow = yaml.safe_load((DOCS / "how-to" / "github-actions.yml").read_text(encoding="utf-8"))
    steps = workflow["jobs"]["calibrate"]["steps"]
    lines = [step["run"] for step in steps if "run" in step]
    assert [line.split()[1] for line in lines if line.startswith("mobilecal ")] == ["check", "calibrate"]
    dockerfile = (DOCS / "how-to" / "Dockerfile").read_text(encoding="utf-8")
    for line in re.findall(r"^COPY (.*)$", dockerfile, flags=re.MULTILINE):
        assert all((REPOSITORY / name).exists() for name in line.split()[:-1])
