"""Exactly once, whatever is lost and whoever dies: a model of one actor and one learner."""

import shutil
import tempfile
from pathlib import Path

from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from appl_dist.actor.spool import Spool
from appl_dist.learner.ingest import Ingest
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.uploader import Uploader
from tests.unit.wire.support import ListStore, make_rollout

ROLLOUTS = [encode_rollout(make_rollout(tag, transitions=1)) for tag in range(64)]


class ExactlyOnce(RuleBasedStateMachine):
    """Rules are what can happen; after each, replay holds a prefix of what the actor put, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.hub = MemoryHub()
        self.store = ListStore()
        self.epoch = 0
        self.put_count = 0
        self.lose = ""  # "request" or "answer": what happens to the next upload or hello
        self.start_learner()
        self.start_actor()

    def start_learner(self) -> None:
        self.epoch += 1
        self.learner_bus = self.hub.connect()
        self.server = UploadServer(self.learner_bus, "run1", Ingest(self.store, None, "run1"), epoch=self.epoch)

    def start_actor(self) -> None:
        self.bus = self.hub.connect()
        deliver = self.bus.get

        def get(key, payload=b"", attachment=b"", timeout_s=5.0):
            lose, self.lose = self.lose, ""
            answer = None if lose == "request" else deliver(key, payload, attachment, timeout_s)
            return None if lose else answer

        self.bus.get = get
        self.spool = Spool(self.folder, "run1/a0")
        self.uploader = Uploader(self.bus, "run1", "a0", self.spool)

    @rule()
    def put(self) -> None:
        if self.put_count < len(ROLLOUTS):
            self.spool.put(ROLLOUTS[self.put_count])
            self.put_count += 1

    @rule()
    def step(self) -> None:
        self.uploader.step()

    @rule()
    def step_without_request(self) -> None:
        self.lose = "request"
        self.uploader.step()

    @rule()
    def step_without_answer(self) -> None:
        self.lose = "answer"
        self.uploader.step()

    @rule()
    def kill_actor(self) -> None:
        self.spool.close()
        self.bus.close()
        self.start_actor()

    @rule()
    def kill_learner(self) -> None:
        self.server.close()
        self.learner_bus.close()
        self.start_learner()

    @invariant()
    def replay_holds_a_prefix(self) -> None:
        tags = self.store.tags("a0")
        assert tags == list(range(len(tags)))
        assert len(tags) + len(self.spool) >= self.put_count  # nothing is in neither place
        assert not self.uploader.refused

    def teardown(self) -> None:
        self.lose = ""
        for _ in range(2 * len(ROLLOUTS)):
            self.uploader.step()
        assert self.store.tags("a0") == list(range(self.put_count))
        self.spool.close()
        self.server.close()
        shutil.rmtree(self.folder)


TestExactlyOnce = ExactlyOnce.TestCase
TestExactlyOnce.settings = settings(max_examples=40, stateful_step_count=40, deadline=None)
