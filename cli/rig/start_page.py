"""Who asks the questions of `start`: a page. Its state as JSON, the answers of its forms, the preview and
drawings.

`GET /state?after=N` waits a second for a state newer than N; `POST /answer` (with the page's token) answers
the form of that id, or goes to a step that was done; `GET /picture` is the newest preview, `GET /drawing?
NAME=TEXT` the rig by answers as they are typed."""

import queue
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import click

import optolever as ol
from optolever import InputError

from .questions import Question
from .views import View, drawn

__all__ = ["Draw", "GoTo", "Interviewer"]

_WAIT_S = 1.0
_LONGEST = 4000  # bytes of an answer
_KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
#: A picture of the rig by answers as typed, into a file; ClickException, InputError of answers that are none.
Draw = Callable[[Mapping[str, str], Path], None]


class GoTo(Exception):  # no error
    """The walk goes on at another step, its argument; without: at the one before."""


class _Answer(NamedTuple):
    """id: of the form; go: a step that was clicked in its place."""

    id: int | None = None
    go: str = ""
    fields: Mapping[str, str] = MappingProxyType({})
    number: int | None = None
    key: str | None = None


class Interviewer:
    """Asks and shows on a page of that program, of these steps (name -> title). All calls wait for the user,
    but for `begin`, `say` and `busy`; GoTo from any that waits. A context manager; port 0: any free one;
    InputError if it is taken."""

    def __init__(self, steps: Mapping[str, str], port: int, program: str) -> None:
        from starlette.routing import Route

        routes = [Route(path, self._file) for path in ("/", "/start.js", "/start.css")]
        routes += [
            Route("/state", self._state),
            Route("/picture", self._picture),
            Route("/drawing", self._draw),
        ]
        routes.append(Route("/answer", self._answer, methods=["POST"]))
        self._web = ol.live.Web(routes, port)
        self._steps, self._program, self._new = steps, program, threading.Condition()
        self._answers: queue.Queue[_Answer] = queue.Queue()
        self._now: dict[str, Any] = {"count": 0, "step": "", "lines": [], "busy": "", "form": None}
        self._forms = self._read = 0  # read: lines above a form that was answered
        self._view: View | None = None
        self._drawing: Draw | None = None

    @property
    def address(self) -> str:
        """Of the page."""
        return self._web.address

    def __enter__(self) -> "Interviewer":
        self._web.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._web.stop()

    def begin(self, step: str, title: str, kind: str) -> None:
        """A step begins, of a rig of that kind; lines stay that no form has shown, or of a step that is tried
        again."""
        lines = self._now["lines"]
        if self._now["step"] != step:
            lines, self._read = lines[self._read :], 0
        self._show(step=step, rig=kind, lines=lines, busy="", form=None, live="")

    def say(self, text: str, fault: bool = False) -> None:
        """A line of the step."""
        self._show(lines=[*self._now["lines"], [text, fault]], busy="")

    def busy(self, text: str) -> None:
        """What is done now."""
        self._show(busy=text)

    def ask(
        self, questions: Sequence[Question], defaults: Mapping[str, str], draw: Draw | None = None
    ) -> dict[str, Any]:
        """The answers by name, converted; a wrong one stays in its field, with the reason."""
        texts, errors = dict(defaults), dict[str, str]()
        self._drawing = draw
        while True:
            fields = [
                {"name": one.name, "text": one.text, "wrong": one.wrong, "value": texts[one.name]}
                | {"error": errors.get(one.name, "")}
                for one in questions
            ]
            given = self._form("ask", fields=fields).fields
            texts |= {one.name: given.get(one.name, "").strip() or texts[one.name] for one in questions}
            answers, errors = dict[str, Any](), {}
            for one in questions:
                try:
                    answers[one.name] = one.kind.convert(texts[one.name], None, None)
                except click.BadParameter as error:
                    errors[one.name] = error.message
            if not errors:
                self._drawing = None
                return answers

    def pick(self, text: str, options: Sequence[str], default: int = 0) -> int:
        """One of several."""
        while True:
            number = self._form("pick", text=text, options=list(options), default=default).number
            if number is not None and 0 <= number < len(options):
                return number

    def go(self, text: str, keys: Mapping[str, str]) -> str:
        """A key of these."""
        while True:
            key = self._form("go", text=text, keys=list(keys.items())).key
            if key is not None and key in keys:
                return key

    def look(self, views: Iterator[View]) -> View | None:
        """The last view before the user goes on."""
        last, form = None, 0
        for last in views:
            if not form:
                form = self._offer("look")
            self._view = last
            self._show(aim=last.numbers())
            answer = self._taken(form, wait=False)
            if answer is not None:
                break
        self._show(form=None)
        return last

    def live(self, address: str) -> None:
        """The page goes there."""
        self._show(live=address, form=None, busy="")

    def _show(self, **changes: Any) -> None:
        with self._new:
            self._now = self._now | changes | {"count": self._now["count"] + 1}
            self._new.notify_all()

    def _offer(self, kind: str, **parts: Any) -> int:
        self._forms += 1
        self._show(form={"id": self._forms, "kind": kind, **parts}, busy="")
        return self._forms

    def _form(self, kind: str, **parts: Any) -> _Answer:
        """The answer of a form."""
        answer = self._taken(self._offer(kind, **parts))
        self._show(form=None)
        assert answer is not None
        return answer

    def _taken(self, form: int, wait: bool = True) -> _Answer | None:
        """The answer of the form of this number; None: none yet. GoTo where another step was clicked."""
        while True:
            try:
                answer = self._answers.get(wait, None)
            except queue.Empty:
                return None
            self._read = len(self._now["lines"])
            if answer.go in self._steps:
                self._show(form=None)
                raise GoTo(answer.go)
            if answer.id == form:
                return answer

    def _file(self, request: Any) -> Any:
        from starlette.responses import Response

        name = request.url.path.removeprefix("/") or "start.html"
        text = Path(__file__).with_name(name).read_text(encoding="utf-8")
        for word, value in (("token", self._web.token), ("program", self._program)):
            text = text.replace(f"{{{{{word}}}}}", value)
        return Response(text, media_type=_KINDS[name.partition(".")[2]])

    def _state(self, request: Any) -> Any:
        from starlette.responses import JSONResponse

        after = request.query_params.get("after", "0")
        number = int(after) if after.isdecimal() and len(after) < 16 else -1
        with self._new:
            self._new.wait_for(lambda: self._now["count"] > number, _WAIT_S)
            return JSONResponse(self._now | {"steps": list(self._steps.items())})

    async def _answer(self, request: Any) -> Any:
        from starlette.responses import PlainTextResponse

        text = b""
        async for part in request.stream():
            text += part
            if len(text) > _LONGEST:
                return PlainTextResponse(f"answer: must be at most {_LONGEST} bytes", 413)
        try:
            from optolever.schema import from_json  # NumPy

            answer = from_json(_Answer, text.decode("utf-8", "replace"), "answer")
        except InputError as error:
            return PlainTextResponse(str(error), 400)
        self._answers.put(answer)
        return PlainTextResponse("")

    def _picture(self, request: Any) -> Any:
        from starlette.responses import Response

        view = self._view
        return Response(b"" if view is None else drawn(view), media_type="image/jpeg")

    def _draw(self, request: Any) -> Any:
        from starlette.responses import PlainTextResponse, Response

        draw = self._drawing
        if draw is None:
            return Response(status_code=204)  # nothing is typed now, as the step has ended
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "rig.png"
            try:
                draw({name: text for name, text in request.query_params.items() if text}, file)
            except (InputError, click.ClickException) as error:
                return PlainTextResponse(" ".join(str(error).split()), 422)
            return Response(file.read_bytes(), media_type="image/png")
