"""`appl-dist keys`: what it makes, for whom, and how it is found."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from cryptography import x509

from appl_dist.errors import UserError
from appl_dist.launch.make_keys import main, make_keys
from appl_dist.wire.credentials import find


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_everything_is_its_owners_only_and_signed_by_one_authority(tmp_path: Path) -> None:
    assert make_keys(tmp_path / "k", ["learner.example", "192.0.2.7"], []) == ["learner", "viewer", "actor"]
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in files(tmp_path))
    assert all(stat.S_IMODE(p.stat().st_mode) == 0o700 for p in (tmp_path / "k").iterdir())
    authority = x509.load_pem_x509_certificate((tmp_path / "k/ca/ca.pem").read_bytes())
    for name in ("learner", "viewer", "actor"):
        certificate = x509.load_pem_x509_certificate((tmp_path / "k" / name / "certificate.pem").read_bytes())
        certificate.verify_directly_issued_by(authority)
        assert certificate.subject.rfc4514_string() == f"CN={name}"
    text = str(x509.load_pem_x509_certificate((tmp_path / "k/learner/certificate.pem").read_bytes()).extensions)
    assert "learner.example" in text
    assert "192.0.2.7" in text


def test_more_identities_can_be_added_and_what_is_there_stays(tmp_path: Path) -> None:
    make_keys(tmp_path, [], ["actor-0"])
    before = {path: path.read_bytes() for path in files(tmp_path)}
    assert make_keys(tmp_path, [], ["actor-0", "actor-1"]) == ["actor-1"]
    after = {path: path.read_bytes() for path in files(tmp_path)}
    changed = {path for path in before if after[path] != before[path]}
    assert changed == {tmp_path / "learner" / "users"}
    assert find(str(tmp_path), "learner").users() == ["learner", "viewer", "actor-0", "actor-1"]
    passwords = {find(str(tmp_path), name).password()[1] for name in ("learner", "viewer", "actor-0", "actor-1")}
    assert len(passwords) == 4
    assert min(map(len, passwords)) >= 32


def test_an_identity_is_found_by_the_longest_name_that_covers(tmp_path: Path) -> None:
    make_keys(tmp_path, [], ["actor", "actor-1"])
    names = {wanted: find(str(tmp_path), wanted).name for wanted in ("actor-1", "actor-1-x", "actor-10", "actor-a-b")}
    assert names == {"actor-1": "actor-1", "actor-1-x": "actor-1", "actor-10": "actor", "actor-a-b": "actor"}
    assert find(str(tmp_path), "actor-1").covers("actor-1-x")
    assert not find(str(tmp_path), "actor-1").covers("actor-10")
    for wanted, says in (("worker", "no credentials for worker"), ("", "holds actor, actor-1 for actors; say which")):
        with pytest.raises(UserError, match=says):
            find(str(tmp_path), wanted)
    with pytest.raises(UserError, match="no folder at"):
        find(str(tmp_path / "none"), "actor")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--actor", "learner"], "'learner' cannot be an actor's name"),
        (["--actor", "a/b"], "'a/b' cannot be"),
        (["--actors", "-1"], "--actors -1"),
        (["--days", "0"], "--days 0"),
    ],
)
def test_what_cannot_be_is_named(tmp_path: Path, arguments: list[str], says: str) -> None:
    with pytest.raises(UserError, match=says):
        main([str(tmp_path / "k"), *arguments])
    assert not (tmp_path / "k").exists()


def test_a_damaged_authority_and_a_full_disk_are_sentences(tmp_path: Path) -> None:
    make_keys(tmp_path / "k", [], [])
    (tmp_path / "k/ca/key.pem").write_text("no key")
    with pytest.raises(UserError, match="is damaged"):
        make_keys(tmp_path / "k", [], ["more"])
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        make_keys(tmp_path / "file", [], [])


def test_open_files_are_warned_about(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    make_keys(tmp_path, [], [])
    (tmp_path / "actor" / "password").chmod(0o644)
    find(str(tmp_path), "actor").password()
    assert "can be read by others; chmod 600 it" in caplog.text


def test_a_file_that_this_user_may_not_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_keys(tmp_path, [], [])
    secret = tmp_path / "learner" / "users"
    allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != secret and allowed(path, mode))  # root may read all
    with pytest.raises(UserError, match=rf"wire\.keys: user \d+ may not read {secret}; chown it"):
        find(str(tmp_path), "learner").users()
