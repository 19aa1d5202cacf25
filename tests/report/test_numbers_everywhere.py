"""One number has one value, one standard deviation and one unit: page, terminal, notebook, CI, JSON and params.yaml."""

import json
import re
from html import unescape

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.report.numbers import decimals_of
from mobilecal_cli.report.text import summary_text
from tests.report.example import make_extraction, make_solution, report_on, solved

NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"


@pytest.fixture(scope="module", params=["standard", "base_fixed", "fixed"])
def report(request):
    if request.param == "standard":
        extraction = make_extraction()
        return report_on(make_solution(extraction, "ml"), extraction)
    if request.param == "base_fixed":
        return report_on(*solved(motion="base_fixed"))
    return report_on(*solved(fixed=("separation",)))


def read(label, text):
    """Value, standard deviation ("" for none) and unit that a text shows beside a label."""
    found = re.search(rf"{label}[^-\d]*?{NUMBER}\s*\|?\s*(?:±\s*{NUMBER})?\s*\|?\s*(rad|m)\b", text)
    assert found, (label, text)
    return found.groups()


def test_every_output_shows_the_same_numbers(report):
    written = parameters_from_yaml(report.params)
    T = written.T_parent_child
    values = [*se3.log_so3(T[:3, :3]), *T[:3, 3], *written.wheels.vector]
    std = np.sqrt(np.diag(written.knowledge.covariance))
    data = json.loads(report.json)
    bare = re.sub(r"<(style|script|svg)\b.*?</\1>", "", report.html, flags=re.DOTALL)
    texts = {
        "page": " ".join(unescape(re.sub(r"<[^>]*>", " ", bare)).split()),
        "terminal": summary_text(report.values),
        "verbose": summary_text(report.values, verbose=True),
        "notebook": unescape(re.sub(r"<[^>]*>", " ", report._repr_html_())),
        "job summary": report.markdown,
    }
    assert [number["name"] for number in data["numbers"]] == list(NINE)
    for k, number in enumerate(data["numbers"]):
        assert number["value"] == pytest.approx(values[k], rel=1e-9, abs=1e-12)
        assert (number["std"] or 0.0) == pytest.approx(std[k], rel=1e-6)
        assert (number["std"] or 0.0) == pytest.approx(data["uncertainty"]["std"][number["name"]])
        if number["std"]:
            assert float(number["std_text"]) == pytest.approx(std[k], rel=0.05)
        decimals = decimals_of(number["std"] or 0.0, 5)
        assert float(number["value_text"]) == pytest.approx(values[k], abs=0.51 * 10.0**-decimals)
        said = (number["value_text"], number["std_text"] or None, number["unit"])
        for where, text in texts.items():
            assert read(number["label"], text) == said, (where, number["label"])


def test_no_other_number_stands_for_a_parameter(report):
    """Millimeters and degrees of the nine numbers are nowhere in prose: they are in m and rad."""
    for number in json.loads(report.json)["numbers"]:
        mm = f"{1e3 * number['value']:.1f} mm"
        if number["unit"] == "m":
            assert mm not in summary_text(report.values, verbose=True)
            assert mm not in report.verdict.reason


def test_constants_have_the_prior_of_the_file(report):
    listed = next(table for table in report.values.tables if table.title == "Estimated constants")
    for name, *_, prior, _, _ in (row if len(row) == 7 else (*row, "") for row in listed.rows):
        sigma = re.search(rf"  {name}: {{.*?prior: ([\d.e+-]+)", report.params)[1]
        if prior != "fixed":
            assert report.values.constants[name].used_prior == pytest.approx(float(sigma), rel=1e-6)
