"""The list of mutants follows the source."""

from benchmarks import mutants
from benchmarks.mutants_list import MUTANTS


def test_every_mutant_can_be_set_in():
    assert mutants.misfits() == []


def test_a_mutant_that_cannot_be_set_in_is_told(monkeypatch):
    gone = MUTANTS[0]._replace(old="a line that stands nowhere")
    twice = MUTANTS[0]._replace(old="import")
    monkeypatch.setattr(mutants, "MUTANTS", [gone, twice, MUTANTS[1]])
    told = mutants.misfits()
    assert [line.split()[0] for line in told] == ["1", "2"]
    assert "0 places" in told[0]
