"""Every equation of the paper is tagged at the function that computes it, and docs/equations.md says where."""

from __future__ import annotations

import pytest

from docs.make_equations import EQUATIONS, PAGE, page, tags


def test_every_equation_has_a_tag_and_every_tag_an_equation():
    assert sorted({tag.number for tag in tags()}) == list(EQUATIONS) == list(range(1, 25))


def test_the_page_is_what_the_tags_say():
    assert PAGE.read_text(encoding="utf-8") == page(tags()), "python -m docs.make_equations"


def test_tags_are_read_from_functions_methods_and_nothing_else(tmp_path):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "a.py").write_text(
        '"""A module.\n\nEquation: 3.\n"""\n'
        'def one():\n    """One.\n\n    Equation: 2.\n    """\n'
        "class Two:\n    def three(self):\n"
        '        """Three, as in equation 9.\n\n        Equations: 1, 2.\n        """\n'
    )
    assert [tuple(tag) for tag in tags(tmp_path / "room")] == [
        (1, "room/a.py", "Two.three"),
        (2, "room/a.py", "one"),
        (2, "room/a.py", "Two.three"),
    ]


@pytest.mark.parametrize("line", ["Equations: 1 to 3.", "Equation: 1, 2.", "Equation: 1", "Equations: 1-3."])
def test_a_tag_in_another_form_is_refused(tmp_path, line):
    (tmp_path / "a.py").write_text(f'def one():\n    """One.\n\n    {line}\n    """\n')
    with pytest.raises(ValueError, match="is not of the form"):
        tags(tmp_path)
