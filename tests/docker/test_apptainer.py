"""docker/appl.def: what it says is read as Apptainer reads it, and run by a Docker engine, where one answers.

Apptainer itself is in neither Debian nor PyPI. Its %post scripts are ordinary shell in an ordinary image, so each stage
becomes one of a Dockerfile; %test then runs as Apptainer would, without a writable file system, as a user of its own.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.docker.test_compose import BUILD_S, ROOT, command, run

DEFINITION = (ROOT / "docker" / "appl.def").read_text()
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
KNOWN = {"arguments", "files", "post", "environment", "runscript", "test", "labels"}
PIP = ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS")


@dataclass
class Stage:
    header: dict[str, str]
    sections: dict[str, list[str]] = field(default_factory=dict)
    files_from: str = ""


def stages(**arguments: str) -> list[Stage]:
    """Every stage starts with its Bootstrap line; {{ NAME }} stands for an argument, of %arguments unless given."""
    defaults = dict(re.findall(r"^ {4}(\w+)=(.*)$", DEFINITION.partition("%arguments")[2].partition("%")[0], re.M))
    text = re.sub(r"{{ (\w+) }}", lambda m: {**defaults, **arguments}[m[1]], DEFINITION)
    found: list[Stage] = []
    section = ""
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        if line.startswith("Bootstrap:"):
            found.append(Stage({}))
            section = ""
        if line.startswith("%"):
            section, *rest = line[1:].split()
            found[-1].sections[section] = []
            if section == "files" and rest:
                assert rest[0] == "from"
                found[-1].files_from = rest[1]
        elif section:
            found[-1].sections[section].append(line.strip())
        elif line.strip():
            name, _, value = line.partition(":")
            found[-1].header[name] = value.strip()
    return found


def test_every_stage_is_whole() -> None:
    build, final = stages()
    for stage in (build, final):
        assert stage.header["Bootstrap"] == "docker"
        assert stage.header["From"] in DOCKERFILE  # one base for all images
        assert stage.sections.keys() <= KNOWN
        for section in stage.sections.keys() & {"post", "environment", "runscript", "test"}:
            checked = subprocess.run(["sh", "-n"], input="\n".join(stage.sections[section]), text=True, check=False)
            assert checked.returncode == 0, section
    assert final.files_from == build.header["Stage"]
    for line in filter(None, build.sections["files"]):
        source, target = line.split()
        assert (ROOT / source).exists()
        assert target == f"/source/{source}"


def test_it_installs_what_the_dockerfile_installs() -> None:
    post = "\n".join(stages()[0].sections["post"])
    for pattern in (r"apt-get install .*?--no-install-recommends ([^\\\n]*)", r"strip (\S+)", r"rm -rf (pybullet.*)"):
        assert {m.strip() for m in re.findall(pattern, post)} == {m.strip() for m in re.findall(pattern, DOCKERFILE)}
    assert '".[learner,evaluate]"' in post
    assert "needs.py learner evaluate" in DOCKERFILE
    assert "-c requirements.lock" in post
    assert "/opt/appl/bin:$PATH" in "\n".join(stages()[1].sections["environment"])


@pytest.mark.timeout(BUILD_S)
def test_its_scripts_build_an_image_that_passes_its_test(tmp_path: Path) -> None:
    command()
    if os.environ["APPL_TEST_DOCKER"] != "1":
        pytest.skip("builds an image of more than 1 GB: set APPL_TEST_DOCKER=1 to run it")
    build, final = stages(**({"TORCH_INDEX": os.environ["TORCH_INDEX"]} if "TORCH_INDEX" in os.environ else {}))
    base = os.environ.get("BASE", build.header["From"])
    for line in filter(None, build.sections["files"]):
        source, target = line.split()
        copy = shutil.copytree if (ROOT / source).is_dir() else shutil.copy
        (tmp_path / target[1:]).parent.mkdir(exist_ok=True)
        copy(ROOT / source, tmp_path / target[1:])
    (tmp_path / "post").write_text("\n".join(build.sections["post"]))
    (tmp_path / "test").write_text("\n".join(final.sections["environment"] + final.sections["test"]))
    copies = "\n".join(f"COPY --from=build {line}" for line in filter(None, final.sections["files"]))
    (tmp_path / "Dockerfile").write_text(
        f"FROM {base} AS build\nARG {' '.join(PIP)}\nCOPY source /source\nCOPY post /post\nRUN /bin/sh -ex /post\n"
        f"FROM {base}\n{copies}\nCOPY test /test\n"
    )
    arguments = [f"--build-arg={name}={os.environ[name]}" for name in PIP if name in os.environ]
    network = f"--network={os.environ.get('BUILD_NETWORK', 'default')}"
    built = run(["docker", "build", "-q", network, *arguments, str(tmp_path)], BUILD_S)
    assert built.returncode == 0, built.stderr[-3000:]
    image = built.stdout.strip()
    try:
        options = ["--rm", "--read-only", "--tmpfs=/tmp", "--user=1234:1234", "--cap-drop=ALL"]
        tested = run(["docker", "run", *options, image, "/bin/sh", "-ex", "/test"])
        assert tested.returncode == 0, tested.stderr
        assert "usage: appl-dist" in tested.stdout
    finally:
        run(["docker", "image", "rm", image])
