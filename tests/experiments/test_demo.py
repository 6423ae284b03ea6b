"""The demo: the names that checks from outside rely on, plain numbers, and a chain that holds together."""

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


def test_chain_recovers_the_dent(demo: DemoResult) -> None:
    """Loose bounds on purpose: how good it is, is measured elsewhere; here a swapped axis or sign would
    show.
    """
    assert demo.metrics["unflagged_share"] > 0.9
    assert demo.metrics["unflagged_invisible"] == 0
    assert demo.metrics["height_rms_rel"] < 0.02
    assert 0.5 < demo.metrics["sigma_ratio_u"] < 2
