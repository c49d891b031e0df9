"""docs/concepts/security.md says of each kind of untrusted file where it is read."""

from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "concepts" / "security.md"
WHERE = {"a confined process", "the main process", "both", "an open process"}


def test_only_python_code_beside_the_world_runs_in_an_open_process():
    _, _, table = PAGE.read_text().partition("| file | read by | where | may | refused |\n")
    lines = table.partition("\n\n")[0].splitlines()[1:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert len(rows) > 20
    assert {(len(row), row[2] in WHERE) for row in rows} == {(5, True)}
    assert [row[0] for row in rows if row[2] == "an open process"] == [
        "Python code of a card's sensors and wrappers"
    ]
