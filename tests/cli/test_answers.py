"""Answers to the page of `start`: of wrong types they are refused, and never reach the walk."""

import json
import queue
import threading

import numpy as np
import pytest

from lab.fuzz.damage import EXTREMES
from optolever.cli.rig.start_page import Interviewer

from .chromium import answered


def test_answers_of_wrong_types_are_refused() -> None:
    rng, chosen = np.random.default_rng(0), queue.Queue[object]()
    with Interviewer({"rig": "Rig"}, 0, "optolever start") as page:
        walk = threading.Thread(target=lambda: chosen.put(page.pick("which", ["a", "b"])), daemon=True)
        walk.start()
        for text, words in (
            ('{"id": 1, "go": [1]}', "answer.go is [1], must be text"),
            ('{"id": 1, "number": true}', "answer.number is True, must be a whole number"),
            ('{"id": 1, "fields": [1]}', "answer.fields is [1], must be a table"),
            ("[" * 3000, "answer is no JSON"),
            ("5", "answer is 5, must be a table"),
        ):
            status, said = answered(page.address, text)
            assert status == 400
            assert words in said
        for _ in range(30):
            name, value = rng.choice(["id", "go", "fields", "number", "key"]), rng.choice(EXTREMES)
            assert answered(page.address, f'{{"id": 9, "{name}": {value}}}')[0] in (200, 400)
        assert walk.is_alive()
        assert answered(page.address, json.dumps({"id": 1, "number": 1}))[0] == 200
        assert chosen.get(timeout=60) == 1
    with pytest.raises(queue.Empty):
        chosen.get_nowait()
