"""What `make lint` finds in prose: the list of `tests.words`."""

from tests import words


def test_the_check_sees_docstrings_messages_comments_templates_and_pages(tmp_path, monkeypatch):
    """Each kind of prose with one unwanted term; code in backticks and template expressions do not count."""
    monkeypatch.setattr(words, "REPOSITORY", tmp_path)
    texts = {
        "a.py": '"""A held direction."""\n# what the log tells\nMESSAGE = "stations looked at"\nheld = "held"\n',
        "b.md": "The log tells it.\n`held`\n```\nheld\n```\n",
        "c.jinja": "<p>It is held.</p>{{ held }}{% if held %}{% endif %}",
    }
    found = {}
    for name, text in texts.items():
        path = tmp_path / name
        path.write_text(text)
        found[name] = sorted(line.split(": ")[1].split("'")[1] for line in words.found_in(path))
    assert found == {"a.py": ["held", "looked at", "tells"], "b.md": ["tells"], "c.jinja": ["held"]}
