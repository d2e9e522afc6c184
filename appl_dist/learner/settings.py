"""Settings of the learner. Free of torch, so that every process can check a configuration."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from appl_dist.learner.limiter import LimiterSettings


@dataclass(frozen=True)
class TD3Settings:
    """Everything `TD3` needs beside the sizes; ValueError names the field that cannot be.

    hidden: widths of the hidden layers of actor and critics; the papers have (512, 512, 512). precision: bf16
    computes the hidden layers in bfloat16, fp32 everything in float32; auto takes bf16 where the hardware multiplies
    it. threads: of torch in the learner's process. layer_norm: normalises the critics' hidden layers. polyak: the
    share of the network in each averaging step of its target. n-step and gamma belong to replay.
    """

    hidden: tuple[int, ...] = (256, 256)
    batch_size: int = 256
    actor_lr: float = 3e-4
    critic_lr: float = 3e-4
    polyak: float = 0.005
    target_noise: float = 0.2
    target_noise_clip: float = 0.5
    policy_delay: int = 2
    layer_norm: bool = False
    precision: str = "auto"
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        if not 1 <= len(self.hidden) <= 32 or not all(1 <= width <= 16_384 for width in self.hidden):
            raise ValueError(f"learner.td3.hidden: got {self.hidden}; allowed 1 to 32 layer widths, each 1..16384")
        for name, high in (("batch_size", 65_536), ("policy_delay", 1000), ("threads", 1024)):
            if not 1 <= getattr(self, name) <= high:
                raise ValueError(f"learner.td3.{name}: got {getattr(self, name)}; allowed 1..{high}")
        for name in ("actor_lr", "critic_lr"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"learner.td3.{name}: got {getattr(self, name)}; allowed above 0 up to 1")
        if not 0.0 < self.polyak <= 1.0:
            raise ValueError(f"learner.td3.polyak: got {self.polyak}; allowed above 0 up to 1")
        for name in ("target_noise", "target_noise_clip"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise ValueError(f"learner.td3.{name}: got {getattr(self, name)}; allowed 0..10")
        if not re.fullmatch(r"cpu|cuda(:\d+)?", self.device):
            raise ValueError(f"learner.td3.device: got {self.device!r}; allowed cpu, cuda, cuda:N")
        if self.precision not in ("auto", "bf16", "fp32"):
            raise ValueError(f"learner.td3.precision: got {self.precision!r}; allowed auto, bf16, fp32")


@dataclass(frozen=True)
class LearnerSettings:
    """The learner process around `TD3`.

    gamma, n_step: of the n-step returns that replay computes. priority_exponent: how strongly TD errors decide what
    is sampled, 0 for uniformly. replay_capacity: transitions. samples_per_insert: how often each transition is
    sampled on average; samples_tolerance: by how many transitions either side may run ahead. min_transitions:
    collected before learning starts.
    init: a run's folder or a policy file whose networks learning starts from.
    Periods in seconds; detail_every in updates.
    """

    td3: TD3Settings = field(default_factory=TD3Settings)
    gamma: float = 0.99
    n_step: int = 1
    priority_exponent: float = 0.0
    replay_capacity: int = 1_000_000
    samples_per_insert: float = 256.0
    samples_tolerance: int = 1000
    min_transitions: int = 1000
    init: str = ""
    publish_every_s: float = 1.0
    report_every_s: float = 1.0
    checkpoint_every_s: float = 20.0
    detail_every: int = 50

    def __post_init__(self) -> None:
        for name, low, high in (
            ("gamma", 0.0, 1.0),
            ("n_step", 1, 100),
            ("priority_exponent", 0.0, 1.0),
            ("replay_capacity", 100, 10**9),
            ("samples_per_insert", 0.1, 1e6),
            ("samples_tolerance", 1, 10**9),
            ("min_transitions", 1, 10**9),
            ("publish_every_s", 0.05, 3600.0),
            ("report_every_s", 0.1, 3600.0),
            ("checkpoint_every_s", 1.0, 86400.0),
            ("detail_every", 1, 10**6),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"learner.{name}: got {value}; allowed {low:g}..{high:g}")
        self.limits()

    def limits(self) -> LimiterSettings:
        """The limiter's settings; ValueError if they could stop both sides for good."""
        try:
            return LimiterSettings(
                self.samples_per_insert,
                self.min_transitions,
                self.samples_tolerance,
                batch_size=self.td3.batch_size,
            )
        except ValueError as e:
            raise ValueError(f"learner: samples_{e}") from None
