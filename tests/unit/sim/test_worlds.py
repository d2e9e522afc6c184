"""Reading worlds: both formats give the same geometry, and a broken file is named."""

from __future__ import annotations

import io
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest

from appl_dist.errors import UserError
from appl_dist.sim.difficulty import c_space, difficulty
from appl_dist.sim.generate import generate_world, generate_worlds
from appl_dist.sim.sdf import parse_sdf
from appl_dist.sim.worlds import field_grid, load_worlds, path_cells
from appl_dist.sim.worlds_command import save_worlds
from tests.shared_data import shared

MODEL = """    <model name='unit_cylinder_{k}'>
      <static>1</static>
      <pose frame=''>{x} {y} 0 0 0 0</pose>
      <link name='link'>
        <collision name='collision'>
          <geometry><cylinder><radius>{radius}</radius><length>1</length></cylinder></geometry>
        </collision>
        <visual name='visual'><geometry><cylinder><radius>9</radius></cylinder></geometry></visual>
      </link>
    </model>
"""


def sdf(*cylinders: tuple[object, object, object]) -> str:
    models = "".join(MODEL.format(k=k, x=x, y=y, radius=r) for k, (x, y, r) in enumerate(cylinders))
    ground = (
        "    <model name='ground_plane'><link><collision><geometry><plane/></geometry></collision></link></model>\n"
    )
    state = "    <state world_name='default'><model name='ground_plane'><pose>0 0 0 0 0 0</pose></model></state>\n"
    return f"<sdf version='1.6'>\n  <world name='default'>\n{ground}{models}{state}  </world>\n</sdf>\n"


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first worlds of the authors' archive: whole, it takes seven seconds."""
    source, out = shared("barn", "worlds.tar.gz"), tmp_path_factory.mktemp("barn") / "worlds.tar"
    wanted = {f"world_{i}.world" for i in (0, 1, 10, 100, 101)} | {f"path_{i}.npy" for i in range(300)}
    with tarfile.open(source) as tar, tarfile.open(out, "w") as small:
        for member in tar:
            if Path(member.name).name in wanted:
                small.addfile(member, tar.extractfile(member))
    return out


def test_both_formats_hold_the_same_worlds(archive: Path) -> None:
    compact = {w.index: w for w in load_worlds(shared("barn"))}
    original = load_worlds(archive)
    assert [w.index for w in original] == [0, 1, 10, 100, 101]
    for world in original:
        twin = compact[world.index]
        np.testing.assert_array_equal(world.cylinders, twin.cylinders)
        np.testing.assert_array_equal(world.path, twin.path)
        np.testing.assert_array_equal(world.path_official, twin.path_official)
        np.testing.assert_allclose(world.metrics, twin.metrics, atol=1e-5)
        assert (world.set_index, world.name) == (twin.set_index, twin.name)


def test_a_folder_reads_like_its_archive(archive: Path, tmp_path: Path) -> None:
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    for a, b in zip(load_worlds(archive), load_worlds(tmp_path), strict=True):
        np.testing.assert_array_equal(a.cylinders, b.cylinders)


def test_the_published_numbers() -> None:
    worlds = load_worlds(shared("barn", "barn_worlds.npz"))
    counts = [len(w.cylinders) for w in worlds]
    assert (len(worlds), min(counts), max(counts)) == (300, 181, 365)
    assert np.mean(counts) == pytest.approx(263.1, abs=0.05)
    assert worlds[0].path[0] == pytest.approx([-0.525, 5.175])
    assert worlds[0].path_official[0] == pytest.approx([-0.675, 5.075])


def test_metrics_are_the_published_ones() -> None:
    data = np.load(shared("barn", "barn_worlds.npz"))
    grids = np.unpackbits(data["grid"], axis=2)[:, :, :30].astype(bool)
    closed = np.unpackbits(data["cspace"], axis=2)[:, :, :30].astype(bool)
    worlds = load_worlds(shared("barn"))
    np.testing.assert_array_equal(c_space(grids), closed)
    for i in range(0, 300, 10):
        np.testing.assert_allclose(difficulty(grids[i], path_cells(worlds[i].path)), data["metrics"][i], atol=1e-5)
    # Without the grid at hand it is read off the cylinders; one cell inside a solid block stays ambiguous.
    read_off = np.array([c_space(field_grid(w.cylinders)) for w in worlds])
    assert (read_off != closed).sum() <= 1


def test_reads_collision_cylinders() -> None:
    cylinders = parse_sdf(sdf((1.5, -2, 0.075), (3, 4, 0.1)).encode(), "a.world")
    np.testing.assert_array_equal(cylinders, [(1.5, -2, 0.075), (3, 4, 0.1)])


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (sdf((1, "x", 0.075)), 6, "<pose> got '1 x 0 0 0 0'"),
        (sdf((1, "nan", 0.075)), 6, "expected 6 finite"),
        (sdf((1, 2, "wide")), 9, "<radius> got 'wide'"),
        (sdf((1, 2, -0.1)), 9, "radius -0.1 m"),
        (sdf((1, 2, 0.1)).replace(" 0 0 0 0</pose>", " 0 0.5 0 0</pose>", 1), 6, "tilted"),
        (sdf((1, 2, 0.1)).replace("</link>", "</lnk>", 1), 3, "not well-formed"),
    ],
)
def test_a_broken_world_file_is_named_with_its_line(text: str, line: int, reason: str) -> None:
    with pytest.raises(UserError, match=rf"^a\.world, line {line}: .*") as error:
        parse_sdf(text.encode(), "a.world")
    assert reason in str(error.value)


def test_entities_and_empty_worlds_are_refused() -> None:
    bomb = "<!DOCTYPE a [<!ENTITY b 'cccc'>]>" + sdf((1, 2, 0.1))
    with pytest.raises(UserError, match="XML entity"):
        parse_sdf(bomb.encode(), "a.world")
    with pytest.raises(UserError, match="holds no cylinder"):
        parse_sdf(sdf().encode(), "a.world")


def world_folder(folder: Path, cells: object = ((3, 0), (3, 1))) -> Path:
    (folder / "path_files").mkdir(parents=True)
    (folder / "world_4.world").write_text(sdf((-2.0, 7.0, 0.075)))
    np.save(folder / "path_files" / "path_4.npy", np.array(cells))
    return folder


def test_a_world_keeps_the_index_of_its_file(tmp_path: Path) -> None:
    (world,) = load_worlds(world_folder(tmp_path / "w"))
    assert (world.index, world.name) == (4, "world_4")


@pytest.mark.parametrize(
    ("cells", "reason"),
    [
        (((3, 0), (3, 30)), "cell index 30"),
        (((3, 0), (5, 1)), "not neighbours"),
        (((3.5, 0), (3, 1)), "integer row, column"),
        (((3, 0),), "at least two rows"),
    ],
)
def test_a_broken_path_is_named(tmp_path: Path, cells: object, reason: str) -> None:
    with pytest.raises(UserError, match=rf"path_4\.npy: .*{reason}"):
        load_worlds(world_folder(tmp_path / "w", cells))


def test_pickled_paths_are_not_unpickled(tmp_path: Path) -> None:
    folder = world_folder(tmp_path / "w")
    np.save(folder / "path_files" / "path_4.npy", np.array([print], dtype=object), allow_pickle=True)
    with pytest.raises(UserError, match=r"path_4\.npy: not a numpy array"):
        load_worlds(folder)


def test_a_world_without_its_path_is_named(tmp_path: Path) -> None:
    folder = world_folder(tmp_path / "w")
    (folder / "path_files" / "path_4.npy").unlink()
    with pytest.raises(UserError, match=r"world_4\.world has no path_files/path_4\.npy"):
        load_worlds(folder)


def test_an_archive_writes_nothing_and_follows_no_link(tmp_path: Path) -> None:
    archive = tmp_path / "evil.tar"
    with tarfile.open(archive, "w") as tar:
        data = sdf((1, 2, 0.1)).encode()
        for name in ("../../world_0.world", "/abs/path_0.npy"):
            info = tarfile.TarInfo(name)
            if name.endswith("npy"):
                buffer = io.BytesIO()
                np.save(buffer, np.array([(3, 0), (3, 1)]))
                data = buffer.getvalue()
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
        link = tarfile.TarInfo("world_1.world")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/hostname"
        tar.addfile(link)
    before = sorted(tmp_path.rglob("*"))
    assert [w.index for w in load_worlds(archive)] == [0]
    assert sorted(tmp_path.rglob("*")) == before


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nowhere: no such file"):
        load_worlds(tmp_path / "nowhere")
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(UserError, match=r"a\.txt: not a world file set"):
        load_worlds(tmp_path / "a.txt")
    with pytest.raises(UserError, match=r"holds no world_<i>\.world file"):
        load_worlds(tmp_path)


def test_a_cut_archive_is_named(archive: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.tar"
    cut.write_bytes(archive.read_bytes()[:300_000])
    with pytest.raises(UserError, match=r"cut\.tar"):
        load_worlds(cut)


def test_generated_worlds_survive_saving(tmp_path: Path) -> None:
    worlds = generate_worlds(3, seed=5)
    save_worlds(worlds, tmp_path)
    for a, b in zip(worlds, load_worlds(tmp_path), strict=True):
        np.testing.assert_array_equal(a.cylinders, b.cylinders)
        np.testing.assert_array_equal(a.path, b.path)
        np.testing.assert_allclose(a.metrics, b.metrics, rtol=1e-6)


@pytest.mark.parametrize(
    ("file", "key", "value", "reason"),
    [
        ("barn_worlds.npz", "offsets", np.array([0, 5, 3, 700], np.int32), "offsets: must rise"),
        ("barn_worlds.npz", "radius", np.float32(-1), "radius: got -1"),
        ("barn_worlds.npz", "centers", np.full((700, 2), np.nan, np.float32), "centers: got"),
        ("barn_worlds.npz", "metrics", np.zeros((2, 5), np.float32), "metrics"),
        ("barn_worlds.npz", "metrics", None, "key metrics is missing"),
        ("barn_paths.npz", "cells", np.full((3, 2), 31, np.int8), "offsets: must rise"),
    ],
)
def test_a_broken_compact_file_is_named_with_its_key(
    tmp_path: Path, file: str, key: str, value: np.ndarray | None, reason: str
) -> None:
    save_worlds(generate_worlds(3), tmp_path)
    with np.load(tmp_path / file) as data:
        arrays = dict(data)
    arrays.pop(key) if value is None else arrays.update({key: value})
    np.savez(tmp_path / file, **arrays)
    with pytest.raises(UserError, match=rf"{file}: .*{reason}"):
        load_worlds(tmp_path)


def test_a_compact_file_needs_its_paths(tmp_path: Path) -> None:
    save_worlds([generate_world(0)], tmp_path)
    shutil.move(tmp_path / "barn_paths.npz", tmp_path / "other.npz")
    with pytest.raises(UserError, match=r"barn_paths\.npz: missing"):
        load_worlds(tmp_path / "barn_worlds.npz")


def test_worlds_cannot_be_changed_by_accident() -> None:
    for world in (generate_world(0), load_worlds(shared("barn"))[0]):
        with pytest.raises(ValueError, match="read-only"):
            world.cylinders[0, 0] = 1.0
