"""One line of the judgements: a test of the program on captures of one kind."""

from dataclasses import dataclass

__all__ = ["Row"]


@dataclass(frozen=True, slots=True)
class Row:
    """part: decode, heights or live; test: its name; kind: of captures; limit: of its figure (NaN: it has
    none that is one number). right: captures whose results are right, false_alarms: of these the ones that
    the test names; wrong: captures with a fault whose results are wrong, missed: of these the ones that it
    does not name."""

    part: str
    test: str
    kind: str
    limit: float
    right: int
    false_alarms: int
    wrong: int
    missed: int
