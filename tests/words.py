"""Terms that the project's prose does not use: `python -m tests.words [PATH ...]` lists every place.

Prose is Markdown, templates, and in Python: docstrings, comments, and strings of more than one word. Code in
backticks, fenced blocks, URLs, placeholders and identifiers are not prose.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
#: Where prose is looked for. Tests are not prose for users.
PROSE = ("README.md", "CHANGELOG.md", "Makefile", "sample_logs", "docs", "mobilecal_cli")
#: Made by the documentation's build, or pictures of what a command printed.
SKIPPED = ("docs/_build", "docs/images")

_PER = (
    "robot|core|station|leg|log|camera|joint|wheel|side|image|picture|turn|corner|second|step|file|topic|line"
)
_IZE = (
    "minimi|optimi|recogni|initiali|normali|seriali|summari|visuali|synchroni|organi|lineari|quanti|parametri"
)
#: Pattern → what to write instead.
TERMS: tuple[tuple[str, str], ...] = (
    # Private terms, and their standard names.
    (r"carried from|carry(ing)? (a |the |its )?(station|corner|point)s?", "predict, transfer"),
    (r"descents?|descend(s|ed|ing)?", "optimization, Levenberg-Marquardt"),
    (r"settl(e|es|ed|ing)", "resolve; converge"),
    (r"believ(e|es|ed|ing)|belief", "inlier; consistent"),
    (r"doubt(s|ed|ful|ing)?", "held-out test; suspect"),
    (r"held(?![- ]out)", "fixed"),
    (r"hid(e|es|den)", "unobservable; occluded"),
    (r"levelled|louder", "with estimated noise; inflated"),
    (r"tainted|at peace|taken back", "affected by a fixed parameter; consistent; restored"),
    (r"preludes?", "robot description"),
    (r"spots?", "saddle response; in place"),
    (r"crews?|draughts?m[ae]n", "worker pool; figure renderer"),
    (r"rooms?|houses?", "module, package"),
    (r"looked at", "used; examined; searched"),
    (r"sound (leg|wheel|station|reading|measurement|log|input)s?", "consistent; correct"),
    (r"left-out", "rejected; outlier"),
    # Riddles.
    (r"every which way", "in random directions"),
    (r"stands? (at|for) (its|a|the) (nominal|radius)", "is fixed at its nominal value; was entered as"),
    (r"is asked for", "limit"),
    (r"worth a look", "check"),
    (r"a wait of|want(s|ed|ing)?", "needs; is missing"),
    (r"tells|told", "reports; states; contains"),
    (rf"(one|once|two|three|four|file|directory|process|number|numbers|value|line|row) an? ({_PER})", "per"),
    # One spelling: American.
    (
        r"colour(s|ed)?|gr[e]y(s|er)?|behaviours?|\w*metres?|centres?|centred|neighbour\w*|licences?|favou?r(?=s|ed)",
        "US spelling",
    ),
    (
        r"modell\w+|labell\w+|travell\w+|cancell(ed|ing)|tyres?|kerbs?|judgements?|analys(e|ed|es|ing)",
        "US spelling",
    ),
    (rf"({_IZE})s(e|ed|es|er|ers|ing|ation|ations)", "US spelling"),
)
_TERMS = tuple((re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE), instead) for pattern, instead in TERMS)
_ANY = re.compile(rf"\b(?:{'|'.join(pattern for pattern, _ in TERMS)})\b", re.IGNORECASE)
_CODE = re.compile(r"⟨[^⟩]*⟩|``[^`]*``|`[^`]*`|https?://\S+|\]\([^)]*\)|<[^>]*>|\{[{%][^}]*[%}]\}")
_FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.MULTILINE | re.DOTALL)

Prose = Iterator[tuple[int, str]]


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match.group())


def _markdown(text: str) -> Prose:
    text = _FENCE.sub(_blank, text)
    for number, line in enumerate(text.splitlines(), 1):
        if not line.startswith("    "):
            yield number, line


def _template(text: str) -> Prose:
    text = re.sub(r"\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}|<style.*?</style>", _blank, text, flags=re.DOTALL)
    yield from enumerate(text.splitlines(), 1)


def _python(text: str) -> Prose:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            for offset, line in enumerate(node.value.splitlines()):
                yield node.lineno + offset, line
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def files(paths: tuple[str, ...] = PROSE) -> Iterator[Path]:
    """Every file with prose under some paths of the repository."""
    for name in paths:
        root = (REPOSITORY / name).resolve()
        for path in [root] if root.is_file() else sorted(root.rglob("*")):
            inside = path.relative_to(REPOSITORY).as_posix()
            if path.suffix in {".md", ".jinja", ".py"} and not inside.startswith(SKIPPED):
                yield path


def found_in(path: Path) -> Iterator[str]:
    """Each unwanted term of a file, as a line that an editor can jump to."""
    reader = {".md": _markdown, ".jinja": _template, ".py": _python}[path.suffix]
    text = path.read_text(encoding="utf-8")
    for number, line in reader(text) if _ANY.search(text) else ():
        prose = _CODE.sub(_blank, line)
        for pattern, instead in _TERMS if _ANY.search(prose) else ():
            for match in pattern.finditer(prose):
                inside = path.relative_to(REPOSITORY)
                yield f"{inside}:{number}: {match.group()!r} ({instead}): {line.strip()[:100]}"


def main() -> None:
    """List what is found, and fail if anything is."""
    lines = [line for path in files(tuple(sys.argv[1:]) or PROSE) for line in found_in(path)]
    print("\n".join(lines))
    print(f"{len(lines)} found")
    sys.exit(bool(lines))


if __name__ == "__main__":
    main()
