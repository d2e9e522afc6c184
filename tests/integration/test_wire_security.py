"""Intruders on a real wire: who gets in, and what those who are in can say."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import zenoh

from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.launch.make_keys import make_keys
from appl_dist.learner.ingest import Ingest
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import (
    MAX_ROLLOUT_BYTES,
    Ack,
    StateHeader,
    UploadHeader,
    WeightsHeader,
    decode_header,
    encode_header,
    encode_rollout,
    pack,
)
from appl_dist.wire.control import ControlClient, ControlServer, fetch_run, fetch_status
from appl_dist.wire.liveness import Presence, Roster
from appl_dist.wire.run_status import Progress
from appl_dist.wire.session import Session, open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings
from tests.unit.wire.support import ListStore, free_endpoint, make_rollout, wait_until


@pytest.fixture(scope="module")
def credentials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Two folders of credentials with the same names: the run's own, and somebody else's."""
    folders = {name: tmp_path_factory.mktemp(name) for name in ("ours", "theirs")}
    for folder in folders.values():
        make_keys(folder, [], ["a0", "a1"])
    return {name: str(folder) for name, folder in folders.items()}


def settings_of(security: str, folder: str, **changes: object) -> WireSettings:
    endpoint = free_endpoint()
    if security == "tls":
        endpoint = endpoint.replace("tcp/", "tls/")
    return replace(WireSettings(endpoint, 1.0, 2.0, security, folder if security != "none" else ""), **changes)


@dataclass
class Learner:
    """Everything a learner says and hears, over one listening session."""

    settings: WireSettings
    session: Session
    store: ListStore
    server: UploadServer
    control: ControlServer
    publisher: WeightsPublisher
    roster: Roster

    def open(self, identity: str, **changes: object) -> Session:
        return open_session(replace(self.settings, **changes), False, identity)  # type: ignore[arg-type]


@pytest.fixture(params=["none", "password", "tls"])
def learner(request: pytest.FixtureRequest, credentials: dict[str, str]) -> Iterator[Learner]:
    settings = settings_of(request.param, credentials["ours"])
    with open_session(settings, listen=True) as session:
        store = ListStore()
        server = UploadServer(session, "run1", Ingest(store, None, "run1"))
        control = ControlServer(session, "run1", "{}", status=lambda: {"actors": len(store.rollouts)})
        publisher = WeightsPublisher(session, "run1")
        publisher.publish(1, 1, b"real")
        roster = Roster(session, "run1")
        yield Learner(settings, session, store, server, control, publisher, roster)
        for part in (roster, publisher, control, server):
            part.close()


def test_an_actor_does_its_work_on_every_wire(learner: Learner, tmp_path: Path) -> None:
    with learner.open("a0") as session, Spool(tmp_path, "run1/a0") as spool:
        assert fetch_run(session) == ("run1", {})
        uploader = Uploader(session, "run1", "a0", spool)
        weights, control = WeightsSubscriber(session, "run1"), ControlClient(session, "run1")
        presence = Presence(session, "run1", "actor", "a0")
        uploader.start()
        for tag in range(3):
            spool.put(encode_rollout(make_rollout(tag)))
        assert uploader.close(drain_s=20.0)
        assert learner.store.tags("a0") == [0, 1, 2]
        assert weights.wait(timeout_s=20.0) == (1, 1, b"real")
        learner.publisher.publish(1, 2, b"newer")
        assert weights.wait((1, 1), timeout_s=20.0) == (1, 2, b"newer")
        assert control.learner_present
        presence.beat(Progress(transitions=9))
        assert wait_until(lambda: any(m.alive and m.progress for m in learner.roster.members()))
        learner.control.set_state("stop")
        assert control.wait_stop(20.0)
        for part in (presence, control, weights):
            part.close()
    with learner.open("viewer") as viewer:
        assert fetch_status(viewer, "run1") == {"actors": 1}


def test_intruders_do_not_get_in(learner: Learner, credentials: dict[str, str], tmp_path: Path) -> None:
    security = learner.settings.security
    if security == "none":
        pytest.skip("open to whoever reaches it")
    keyless = WireSettings(learner.settings.endpoint.replace("tls/", "tcp/"), timeout_s=0.7)
    renamed = tmp_path / "renamed"
    shutil.copytree(Path(credentials["ours"]) / "a0", renamed / "a9")
    (renamed / "a9" / "password").write_text((renamed / "a9" / "password").read_text().replace("a0:", "a9:"))
    half = tmp_path / "half"  # the right authority, but somebody else's certificate
    shutil.copytree(Path(credentials["theirs"]) / "a0", half / "a0")
    shutil.copy(Path(credentials["ours"]) / "a0" / "ca.pem", half / "a0" / "ca.pem")
    intruders = {
        "without credentials": keyless,
        "of another authority, or with a wrong password": replace(learner.settings, keys=credentials["theirs"]),
        "with a certificate of another authority": replace(learner.settings, keys=str(half)),
    }
    if security == "password":
        intruders["with a name nobody listed"] = replace(learner.settings, keys=str(renamed), identity="a9")
    for who, settings in intruders.items():
        with pytest.raises(UserError, match="refused the credentials"):  # noqa: PT012
            open_session(replace(settings, timeout_s=0.7), False, "a0").close()
            pytest.fail(f"an intruder {who} got in")


def test_an_actors_certificate_does_not_make_a_learner(credentials: dict[str, str], tmp_path: Path) -> None:
    stolen = tmp_path / "stolen"
    shutil.copytree(Path(credentials["ours"]) / "a0", stolen / "learner")
    (stolen / "learner" / "users").write_text("a0:x\n")
    (stolen / "learner" / "users").chmod(0o600)
    settings = settings_of("tls", str(stolen), timeout_s=0.7)
    with (
        open_session(settings, listen=True),
        pytest.raises(UserError, match="refused the credentials"),
    ):
        open_session(replace(settings, keys=credentials["ours"]), False, "a1")


FORBIDDEN: dict[str, Callable[[Session], object]] = {
    "weights": lambda s: s.put(keys.weights("run1"), b"x", encode_header(WeightsHeader("run1", 9, 9, 1))),
    "stop": lambda s: s.put(keys.state("run1"), encode_header(StateHeader("run1", 9, 9, "stop"))),
    "answers for the learner": lambda s: s.serve(
        keys.upload("*", "*"), lambda query: query.reply(encode_header(Ack("stored", 99)))
    ),
    "another run": lambda s: s.serve(
        keys.RUN, lambda query: query.reply(pack({"wire": WIRE_VERSION, "run": "evil", "config": "{}"}))
    ),
    "old weights": lambda s: s.serve(
        keys.weights("run1"), lambda query: query.reply(b"x", encode_header(WeightsHeader("run1", 9, 9, 1)))
    ),
    "a learner's token": lambda s: s.announce(keys.alive("run1", "learner", "learner", s.identity)),
    "deletes weights": lambda s: s._session.delete(keys.weights("run1")),
}


def test_an_actor_cannot_say_what_the_learner_says(learner: Learner) -> None:
    with learner.open("a0") as rogue, learner.open("a1") as honest:
        weights = WeightsSubscriber(honest, "run1", poll_s=0.1)
        control = ControlClient(honest, "run1", poll_s=0.1)
        handles = [say(rogue) for say in FORBIDDEN.values()]
        for name in ("weights", "stop"):
            for _ in range(20):
                FORBIDDEN[name](rogue)
        for _ in range(10):
            assert fetch_run(honest)[0] == "run1"
        hello = UploadHeader("run1", "a1", honest.identity, 0, 0, 0, hello=True)
        answer = honest.get(keys.upload("run1", "a1"), b"", encode_header(hello))
        assert answer is not None
        assert decode_header(Ack, answer.payload).status == "welcome"
        learner.publisher.publish(2, 1, b"next")
        assert weights.wait((1, 1), timeout_s=20.0) == (2, 1, b"next")
        assert weights.counts["malformed"] == 0
        assert control.state() == "run"
        assert len(handles) == len(FORBIDDEN)
        weights.close()
        control.close()


def test_an_actor_cannot_speak_for_another_or_listen_to_it(learner: Learner) -> None:
    if learner.settings.security == "none":
        pytest.skip("without credentials nobody has a name")
    heard: list[str] = []
    with learner.open("a0") as rogue, learner.open("a0") as ear, learner.open("a1") as honest:
        for key in ("appl/**", keys.progress("run1", "*", "*"), keys.upload("*", "*")):
            ear.subscribe(key, lambda message: heard.append(message.key))
        ear.watch(keys.alive("run1", "actor", "*", "*"), lambda key, _: heard.append(key))
        rogue.announce(keys.claim("run1", "a1", rogue.identity))
        rogue.announce(keys.alive("run1", "actor", "a1", rogue.identity))
        rogue.put(
            keys.progress("run1", "actor", "a1"),
            pack({"wire": WIRE_VERSION, "incarnation": "x", "progress": {"lie": 1}}),
        )
        header = UploadHeader("run1", "a1", rogue.identity, 0, 0, 0, hello=True)
        for key in (keys.upload("run1", "a1"), keys.upload("run1", "*"), "appl/**"):
            assert rogue.get(key, b"", encode_header(header), timeout_s=1.0) is None
        assert rogue.get(f"@/{learner.session.identity}/**", timeout_s=1.0) is None  # zenoh's own administration
        answer = rogue.get(keys.upload("run1", "a0"), b"", encode_header(header))
        assert answer is not None  # its own key, with another's name inside
        assert decode_header(Ack, answer.payload).status == "refused"
        presence = Presence(honest, "run1", "actor", "a1")
        presence.beat(Progress(transitions=5))
        assert wait_until(lambda: any(m.progress for m in learner.roster.members()))
        [member] = [m for m in learner.roster.members() if m.member_id == "a1"]
        assert member.progress == Progress(transitions=5)
        assert member.incarnation == honest.identity
        header = UploadHeader("run1", "a1", honest.identity, 0, 0, 0, hello=True)
        answer = honest.get(keys.upload("run1", "a1"), b"", encode_header(header))
        assert answer is not None
        assert decode_header(Ack, answer.payload).status == "welcome"
        presence.close()
    assert heard == []


class Flood:
    """Sends as fast as it can what its identity may send: junk uploads, questions, progress, oversized messages."""

    def __init__(self, session: Session, name: str) -> None:
        self._session, self._name = session, name
        self._free = threading.Semaphore(64)
        self.sent = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> None:
        self._end.set()
        self._thread.join(60)

    def _run(self) -> None:
        questions = [keys.upload("run1", f"{self._name}-{i}") for i in range(200)]
        questions += [keys.upload("run1", self._name), keys.status("run1"), keys.RUN]
        while not self._end.is_set():
            self._free.acquire()
            size = MAX_ROLLOUT_BYTES + (1 << 20) if self.sent % 2000 == 0 else 100
            self._session._session.get(
                questions[self.sent % len(questions)],
                zenoh.handlers.Callback(lambda _: None, self._free.release),
                payload=bytes(size),
                timeout=10.0,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            self._session.put(keys.progress("run1", "actor", self._name), b"junk")
            self.sent += 1


def test_a_flood_does_not_keep_an_honest_actor_from_its_work(learner: Learner, tmp_path: Path) -> None:
    with (
        learner.open("a0") as rogue,
        learner.open("a1") as honest,
        learner.open("viewer") as viewer,
        Spool(tmp_path, "run1/a1") as spool,
    ):
        uploader = Uploader(honest, "run1", "a1", spool)
        uploader.start()
        flood = Flood(rogue, "a0")
        assert wait_until(lambda: flood.sent > 500, 60.0)
        for tag in range(100):
            spool.put(encode_rollout(make_rollout(tag)))
        assert uploader.close(drain_s=60.0)
        assert fetch_status(viewer, "run1", 20.0)["actors"] == 1
        flood.end()
    assert learner.store.tags("a1") == list(range(100))
    assert uploader.counts["busy"] == uploader.counts["unanswered"] == 0
    assert list(learner.store.rollouts) == ["a1"]
    assert all(sender.startswith("run1/a0") for sender in learner.server.refused(1000))
    assert learner.roster.counts["malformed"] < flood.sent / 4


def test_a_viewer_can_only_look(learner: Learner) -> None:
    if learner.settings.security == "none":
        pytest.skip("without credentials nobody has a name")
    with learner.open("viewer") as viewer:
        assert fetch_run(viewer)[0] == "run1"
        header = UploadHeader("run1", "viewer", viewer.identity, 0, 0, 0, hello=True)
        assert viewer.get(keys.upload("run1", "viewer"), b"", encode_header(header), timeout_s=1.0) is None
        viewer.announce(keys.alive("run1", "actor", "viewer", viewer.identity))
        viewer.put(keys.progress("run1", "actor", "viewer"), b"x")
        assert fetch_run(viewer)[0] == "run1"
    assert [member.role for member in learner.roster.members()] == ["learner"]
    assert learner.roster.counts["malformed"] == 0
