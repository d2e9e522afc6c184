"""Text stays text: from the command line, into the configuration, and on to other processes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from appl_dist import overrides
from appl_dist.config import Settings, load
from appl_dist.errors import UserError

SMALL = ["world.count=6"]


@pytest.mark.parametrize(
    "text",
    ["20260101_120000", "007", "1e5", "yes", "null", "a=b", "#x", "(x", "a,b", "[1]", "{a: 1}", "it's", " x ", "ü"],
)
def test_text_keys_keep_what_was_written(text: str) -> None:
    assert load([*SMALL, f"run.folder={text}"]).run.folder == text
    assert load([*SMALL, overrides.quoted("run.folder", text)]).run.folder == text


@given(st.text(st.characters(blacklist_categories=["Cs"]), max_size=40))
def test_what_one_process_quotes_another_reads(text: str) -> None:
    argument = overrides.quoted("run.folder", text)
    texts, others = overrides.split([argument], Settings)
    if others:  # an interpolation is Hydra's
        assert "${" in text
    else:
        assert texts == [("run.folder", text)]


def test_labels_of_methods_are_names_of_any_kind() -> None:
    found = load([*SMALL, "+evaluation.methods.my-policy=set:max_vel_x=1.0", "evaluation.methods.v2.1=default"])
    assert found.evaluation.methods == {
        "default": "default", "my-policy": "set:max_vel_x=1.0", "v2.1": "default",
    }  # fmt: skip


def test_an_ipv6_endpoint_needs_no_quotes() -> None:
    assert load([*SMALL, "wire.endpoint=tcp/[::1]:17604"]).wire.endpoint == "tcp/[::1]:17604"


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        ("run.folders=a", "run.folders"),
        ("learner.n_step=a b", "learner.n_step"),
        ("planner.sim_time=(", "planner.sim_time"),
        ("world=mars", "world: got 'mars'; allowed barn, generated"),
        ("nonsense", "expected key=value"),
        ("run.seed=1.5", "run.seed"),
    ],
)
def test_what_cannot_be_read_is_named_with_its_key(argument: str, sentence: str) -> None:
    with pytest.raises(UserError, match=sentence.replace(".", r"\.")) as caught:
        load([*SMALL, argument])
    assert "\n" not in str(caught.value)
