"""docs/concepts/security.md says of each kind of file what the code says."""

from pathlib import Path

from nw_eval.confinement.files import FILES, table

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "security.md"


def test_the_page_shows_the_table_of_the_code():
    assert f"\n{table()}\n" in PAGE.read_text()


def test_only_python_code_beside_the_world_runs_in_an_open_process():
    assert [file.kind for file in FILES if file.where == "an open process"] == [
        "Python code of a card's sensors and wrappers"
    ]
