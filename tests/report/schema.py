"""report.json against its generated schema."""

import json
from functools import cache
from pathlib import Path

import jsonschema

SCHEMA = Path(__file__).parents[2] / "docs" / "reference" / "report.schema.json"


@cache
def _validator():
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def validated(text):
    """The content of a report.json; jsonschema.ValidationError where the schema does not allow it."""
    data = json.loads(text)
    _validator().validate(data)
    return data
