"""How a process starts: streams, terminals and folders that are not as usual; other processes where it wants to be."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from appl_dist import files
from appl_dist.config import Settings, load, load_continued
from appl_dist.errors import UserError
from appl_dist.launch import runs
from appl_dist.launch.evaluation import DEFAULT_FOLDER
from appl_dist.launch.fleet import actors
from appl_dist.overrides import split
from appl_dist.wire.control import ControlServer
from appl_dist.wire.wire_settings import WireSettings

SMALL = ("world.count=6", "world.train=0:1", "evaluation.worlds=1:2")
ROLE = [sys.executable, "-m", "appl_dist"]


def shell(line: str, arguments: Sequence[str], cwd: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """`line` with "$@" for the command and its arguments."""
    command = ["bash", "-o", "pipefail", "-c", line, "bash", *ROLE, *arguments]
    return subprocess.run(command, cwd=cwd, env=os.environ | environment, capture_output=True, timeout=120, check=False)


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "latin-1"},
        {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
        {"TERM": "dumb", "COLUMNS": "0", "LINES": "none"},
        {"HOME": "", "TMPDIR": "/does/not/exist", "MPLBACKEND": "module://matplotlib_inline.backend_inline"},
    ],
    ids=lambda e: next(iter(e)),
)
def test_an_inherited_environment_does_no_harm(environment: dict[str, str], tmp_path: Path) -> None:
    told = shell('"$@"', ["--help"], tmp_path, **environment)
    assert (told.returncode, told.stderr) == (0, b"")
    assert b"actors anywhere connect" in told.stdout
    missing = shell('"$@"', ["status", "actor.run=ü"], tmp_path, **environment)
    assert missing.returncode == 2
    assert missing.stderr.startswith(b"appl-dist status: actor.run: no folder at ")
    drawn = shell('"$@"', ["worlds", "draw", "", "--out", "ü.png"], tmp_path, **environment)
    assert drawn.returncode == 0, drawn.stderr
    assert len(list(tmp_path.glob("*.png"))) == 1


@pytest.mark.parametrize(
    ("line", "status", "says"),
    [
        ('"$@" | true', 141, ""),
        ('"$@" >&-', 0, ""),
        ('"$@" >&- 2>&-', 0, ""),
        ('"$@" 0<&- >&-', 0, ""),
        ('"$@" >/dev/full', 2, "appl-dist: the output cannot be written: No space left on device; free some space"),
    ],
)
def test_a_closed_or_full_output_ends_without_a_traceback(line: str, status: int, says: str, tmp_path: Path) -> None:
    done = shell(line, ["--help"], tmp_path)
    assert done.returncode == status
    assert done.stderr.decode().startswith(says)
    assert len(done.stderr.splitlines()) == bool(says)


def test_a_file_written_while_output_is_closed_holds_no_output(tmp_path: Path) -> None:
    done = shell('"$@" >&-', ["worlds", "draw", "", "--out", "a.png"], tmp_path)
    assert done.returncode == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EACCES, "a folder that you may use"),
        (errno.EROFS, "can be written"),
        (errno.ENOTDIR, "part of this path is a file"),
        (errno.ENAMETOOLONG, "a shorter name"),
        (errno.EMFILE, "more open files"),
        (errno.EUCLEAN, "choose another folder"),
    ],
)
def test_advice_fits_the_fault(number: int, advice: str) -> None:
    sentence = files.explain(OSError(number, os.strerror(number), "x"))
    assert sentence.startswith(f"{os.strerror(number)}; ")
    assert advice in sentence


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_missing_locks_are_not_taken_for_held_ones(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(descriptor: int, how: int) -> None:
        raise OSError(number, os.strerror(number))

    with (tmp_path / "lock").open("w") as file:
        files.lock(file.fileno(), tmp_path / "lock", "held")
        with (tmp_path / "lock").open() as other, pytest.raises(UserError, match=r"^held$"):
            files.lock(other.fileno(), tmp_path / "lock", "held")
        monkeypatch.setattr("fcntl.flock", refuse)
        with pytest.raises(UserError, match="this file system has no locks"):
            files.lock(file.fileno(), tmp_path / "lock", "held")


def test_a_file_where_a_folder_should_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"run\.folder: .*file/run cannot be made: File exists; a file has this name"):
        runs.prepare(load([*SMALL, f"run.folder={tmp_path}/file/run"]))
    with pytest.raises(UserError, match=r"evaluation\.folder: .* cannot be made"):
        runs.make_folder(tmp_path / "file" / "evaluation", "evaluation.folder")
    with pytest.raises(UserError, match=r"actor\.run: .*file is a file"):
        actors(load([f"actor.run={tmp_path}/file"]))


def test_a_run_overwrites_nothing_in_a_folder_that_is_not_its_own(tmp_path: Path) -> None:
    (tmp_path / "policy.safetensors").write_text("another's")
    with pytest.raises(UserError, match=r"run\.folder: .* holds policy\.safetensors, which a run would overwrite"):
        runs.prepare(load([*SMALL, f"run.folder={tmp_path}"]))
    assert [path.name for path in tmp_path.iterdir()] == ["policy.safetensors"]


def test_folders_made_in_the_same_second_differ(tmp_path: Path) -> None:
    made = [runs.make_folder(tmp_path / DEFAULT_FOLDER, "evaluation.folder") for _ in range(3)]
    assert len(set(made)) == 3
    assert all(folder.is_dir() for folder in made)


def test_lists_of_text_keep_what_was_written() -> None:
    texts, others = split(["launch.extra=[--account=123_456, '--comment=a,b', --nice=010]", "launch.bind=[]"], Settings)
    assert not others
    assert dict(texts) == {
        "launch.extra": ["--account=123_456", "--comment=a,b", "--nice=010"], "launch.bind": [],
    }  # fmt: skip
    assert load(["launch.extra=[--account=123_456]"]).launch.extra == ("--account=123_456",)
    with pytest.raises(UserError, match=r"launch\.extra"):
        load(["launch.extra=[--a"])


def test_a_continued_run_takes_labels_with_dots_and_gives_methods_up(tmp_path: Path) -> None:
    _, folder = runs.prepare(load([*SMALL, f"run.folder={tmp_path}/run"]))
    more = load_continued(folder, ["+evaluation.methods.v2.1=set:max_vel_x=1", "~evaluation.methods.default"])
    assert more.evaluation.methods == {"v2.1": "set:max_vel_x=1"}
    assert more.run.id == load_continued(folder).run.id != ""


def test_a_taken_port_is_named_by_the_run_that_has_it(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    wire = WireSettings(endpoint=f"tcp/127.0.0.1:{port}")
    with (
        runs.listen(wire) as session,
        contextlib.closing(ControlServer(session, "first-0123456789abcdef", "{}")),
        pytest.raises(UserError, match=rf"{port} is already in use by run first-0123456789abcdef; choose"),
    ):
        runs.listen(wire)
    with socket.create_server(("127.0.0.1", port)), pytest.raises(UserError, match="in use by another process"):
        runs.listen(wire)
