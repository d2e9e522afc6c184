"""Every number of the configuration: absurd values are refused in one sentence, or the parts can be built with them."""

from __future__ import annotations

import copy
import dataclasses
import math
import typing
from collections.abc import Iterator
from typing import Any

import pytest

from appl_dist.config import Settings, compose_dict, from_dict, load
from appl_dist.errors import UserError
from appl_dist.launch.environment import check_environment, worlds_of

PLAIN = compose_dict(["world.count=6", "world.train=0:1", "evaluation.worlds=1:2"])
VALUES = (0, -1, math.nan)
BUILT = ("robot", "lidar", "timing", "planner", "protocol", "env", "reward")  # what an environment is made of


def numbers(kind: type, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], type]]:
    """(path, type) of every numeric field below `kind`."""
    for name, hint in typing.get_type_hints(kind).items():
        inside = next(h for h in typing.get_args(hint) or (hint,) if h is not type(None))
        if dataclasses.is_dataclass(inside):
            yield from numbers(typing.cast(type, inside), (*path, name))
        elif inside in (int, float):
            yield (*path, name), inside


FIELDS = list(numbers(Settings))


def changed(path: tuple[str, ...], value: float) -> dict[str, Any]:
    plain = copy.deepcopy(PLAIN)
    place = plain
    for group in path[:-1]:
        place = place[group]
    place[path[-1]] = value
    return plain


def test_there_are_fields_to_try() -> None:
    assert len(FIELDS) > 80
    check_environment(from_dict(PLAIN))


@pytest.mark.parametrize("path", [path for path, _ in FIELDS], ids=".".join)
def test_absurd_numbers_are_refused_by_name_or_work(path: tuple[str, ...]) -> None:
    kind = dict(FIELDS)[path]
    for value in VALUES:
        if kind is int and not (math.isfinite(value) and float(value).is_integer() and abs(value) < 2**63):
            continue
        sentence = complaint(changed(path, int(value) if kind is int else value), build=path[0] in BUILT, group=path[0])
        assert sentence is None or path[-1].split("_")[0] in sentence, (value, sentence)
        assert sentence is None or len(sentence.splitlines()) == 1


def complaint(plain: dict[str, Any], build: bool, group: str = "") -> str | None:
    try:
        settings = from_dict(plain)
        if build:
            check_environment(settings)
        elif group == "world":
            worlds_of(settings, "0:1")
        elif group == "learner":
            assert settings.learner.td3.batch_size < 2**20 and max(settings.learner.td3.hidden) < 2**20
    except UserError as error:
        return str(error)
    return None


@pytest.mark.parametrize("argument", ["hidden=[0]", "hidden=[]", "hidden=[1000000000]", "device=gpu", "precision=fp8"])
def test_networks_that_cannot_be_are_refused_before_there_is_a_folder(argument: str) -> None:
    with pytest.raises(UserError, match=rf"learner\.td3\.{argument.partition('=')[0]}: got .*allowed"):
        load(["world.count=6", f"learner.td3.{argument}"])
