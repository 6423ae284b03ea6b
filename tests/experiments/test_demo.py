"""The demo: the names that checks from outside rely on, plain numbers."""

import json
import math

from optolever.experiments import DemoResult

RELIED_ON = (
    "height_rms_rel", "unflagged_share", "sigma_ratio_height", "sigma_ratio_u", "seconds", "peak_bytes",
)  # fmt: skip


def test_numbers_have_their_names_and_are_plain(demo: DemoResult) -> None:
    plain = json.loads(json.dumps(demo.to_dict()))
    for name in RELIED_ON:
        assert name in plain
    assert {"trace", "capture", "decode", "reconstruct", "total"} <= set(plain["seconds"])
    assert plain["peak_bytes"] > 1e7
    assert all(math.isfinite(value) for value in demo.metrics.values())
