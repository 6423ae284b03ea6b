"""Who asks the questions of `start`: what a front must do, and the one on the terminal."""

import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import click

from .questions import Question
from .views import View

__all__ = ["BACK", "Draw", "Front", "GoTo", "Terminal"]

BACK = "<"
_LINE_S = 1.0  # between two lines of the preview

#: A picture of the rig by answers as typed, into a file; ClickException, InputError of answers that are none.
Draw = Callable[[Mapping[str, str], Path], None]


class GoTo(Exception):  # no error
    """The walk goes on at another step, its argument; without: at the one before."""


class Front(Protocol):
    """Asks and shows. All calls wait for the user, but for `begin`, `say` and `busy`; GoTo from any.
    on_display: the preview belongs on the rig's display, even where there is another."""

    @property
    def on_display(self) -> bool:
        """Of the preview."""

    def begin(self, step: str, title: str, kind: str) -> None:
        """A step begins, of a rig of that kind."""

    def say(self, text: str, fault: bool = False) -> None:
        """A line of the step."""

    def busy(self, text: str) -> None:
        """What is done now."""

    def ask(
        self, questions: Sequence[Question], defaults: Mapping[str, str], draw: Draw | None = None
    ) -> dict[str, Any]:
        """The answers by name, converted."""

    def pick(self, text: str, options: Sequence[str], default: int = 0) -> int:
        """One of several."""

    def go(self, text: str, keys: Mapping[str, str]) -> str:
        """A key of these (key: word), the first one by Enter."""

    def look(self, views: Iterator[View]) -> View | None:
        """The last view before the user goes on."""

    def live(self, address: str) -> None:
        """The page of the live view is at this address."""


class Terminal:
    """Prompts; `<` goes back a step."""

    def __init__(self, on_display: bool = False) -> None:
        self.on_display = on_display
        self._lines: queue.Queue[str | BaseException] | None = None  # of a prompt without an answer so far

    def begin(self, step: str, title: str, kind: str) -> None:
        """A step begins, of a rig of that kind."""
        click.secho(f"\n{title}", bold=True)

    def say(self, text: str, fault: bool = False) -> None:
        """A line of the step."""
        click.secho(f"  {text}", fg="red" if fault else None)

    def busy(self, text: str) -> None:
        """What is done now."""
        click.echo(f"  {text} ...")

    def ask(
        self, questions: Sequence[Question], defaults: Mapping[str, str], draw: Draw | None = None
    ) -> dict[str, Any]:
        """The answers by name, converted; the picture is that of the file at the end."""
        answers = {}
        for each in questions:
            click.echo(f"  {each.text}" + click.style(f"; wrong: {each.wrong}", dim=True))
            while True:
                text = self._line(f"    [{defaults[each.name]}]") or defaults[each.name]
                try:
                    answers[each.name] = each.kind.convert(text, None, None)
                    break
                except click.BadParameter as error:
                    self.say(error.message, fault=True)
        return answers

    def pick(self, text: str, options: Sequence[str], default: int = 0) -> int:
        """One of several, by its number."""
        for number, option in enumerate(options, 1):
            click.echo(f"  {number}  {option}")
        while True:
            answer = self._line(f"  {text} [{default + 1}]") or str(default + 1)
            if answer.isdecimal() and 1 <= int(answer) <= len(options):
                return int(answer) - 1
            self.say(f"{answer!r}, must be 1 to {len(options)}", fault=True)

    def go(self, text: str, keys: Mapping[str, str]) -> str:
        """A key of these, the first one by Enter."""
        first, *others = keys
        words = ", ".join([f"Enter: {keys[first]}", *(f"{key}: {keys[key]}" for key in others)])
        while True:
            answer = self._line(f"  {text} ({words})")[:1].lower()
            if not answer or answer in keys:
                return answer or first
            self.say(f"{answer!r}, must be Enter{''.join(f' or {key}' for key in others)}", fault=True)

    def look(self, views: Iterator[View]) -> View | None:
        """A line a second until Enter, here or on the display."""
        said, last = -1.0, None
        for last in views:
            if said < 0:
                self._prompt("  Enter goes on")
            if time.monotonic() > said + _LINE_S:
                self.say(last.text())
                said = time.monotonic()
            assert self._lines is not None
            if not self._lines.empty():
                self._answer()
                break
        return last

    def live(self, address: str) -> None:
        """Nothing: lines follow."""

    def _line(self, text: str) -> str:
        """What is typed; GoTo for `<`."""
        self._prompt(text)
        return self._answer()

    def _prompt(self, text: str) -> None:
        """Wait for a line on a thread; one that still waits gets this question."""
        if self._lines is not None:
            click.echo(f"{text}: ", nl=False)
            return
        lines = self._lines = queue.Queue()

        def wait() -> None:
            try:
                lines.put(str(click.prompt(text, default="", show_default=False)).strip())
            except BaseException as error:  # handed to the walk
                lines.put(error)

        threading.Thread(target=wait, daemon=True).start()

    def _answer(self) -> str:
        assert self._lines is not None
        answer, self._lines = self._lines.get(), None
        if isinstance(answer, BaseException):
            raise answer
        if answer == BACK:
            raise GoTo
        return answer
