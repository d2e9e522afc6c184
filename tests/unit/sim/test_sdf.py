"""World files by hand: what stands in the way is read where it is, or refused by line."""

from __future__ import annotations

import numpy as np
import pytest

from appl_dist.errors import UserError
from appl_dist.sim.sdf import parse_sdf

CYLINDER = "<geometry><cylinder><radius>{r}</radius><length>1</length></cylinder></geometry>"


def model(x: float, y: float, link: str = "", collision: str = "", shape: str = CYLINDER, yaw: float = 0.0) -> str:
    return (
        f"<model name='m'><static>1</static><pose>{x} {y} 0 0 0 {yaw}</pose><link name='l'>{link}"
        f"<collision name='c'>{collision}{shape.format(r=0.1)}</collision></link></model>"
    )


def world(text: str) -> bytes:
    return f"<sdf version='1.6'>\n<world name='w'>\n{text}\n</world>\n</sdf>".encode()


def read(text: str) -> np.ndarray:
    return parse_sdf(world(text), "a.world")


def test_poses_of_model_link_and_collision_are_composed() -> None:
    link, collision = "<pose>0 2 0 0 0 1.5707963267948966</pose>", "<pose>1 0 0 0 0 0</pose>"
    assert read(model(3, 4, link, collision)) == pytest.approx(np.array([[3, 7, 0.1]]))
    turned = read(model(3, 4, link, collision, yaw=np.pi / 2))
    assert turned == pytest.approx(np.array([[0, 4, 0.1]]))


def test_a_saved_state_moves_a_model() -> None:
    state = "<state world_name='w'><model name='m'><pose>-2 8 0 0 0 0</pose>{}</model></state>"
    link = "<link name='l'><pose>{} 8 0 0 0 0</pose></link>"
    assert read(model(3, 4) + state.format(link.format(-2))) == pytest.approx(np.array([[-2, 8, 0.1]]))
    with pytest.raises(UserError, match="<state> moves link 'l' within its model"):
        read(model(3, 4) + state.format(link.format(-1)))
    with pytest.raises(UserError, match="<state> scales model 'm'"):
        read(model(3, 4) + state.format("<scale>2 2 1</scale>"))
    with pytest.raises(UserError, match="model 'm' that the world lacks"):
        read(model(3, 4).replace("'m'", "'n'") + state.format(""))


def test_every_collision_of_a_model_counts() -> None:
    second = f"<collision name='d'><pose>1 0 0 0 0 0</pose>{CYLINDER.format(r=0.2)}</collision></link>"
    assert len(read(model(0, 5).replace("</link>", second))) == 2


GROUND = model(0, 0, shape="<geometry><plane><normal>0 0 1</normal><size>9 9</size></plane></geometry>")


def test_ground_and_appearance_do_not_matter() -> None:
    light = "<light name='sun'><pose>0 0 10 0 1 0</pose></light><gui><camera/></gui><physics type='ode'/>"
    visual = "<visual name='v'><geometry><box><size>1 1 1</size></box></geometry></visual>"
    assert len(read(light + GROUND + model(1, 5, link=visual))) == 1


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (model(0, 8, shape="<geometry><box><size>6 1 1</size></box></geometry>"), "line 3: model 'm' is a <box>"),
        (model(0, 8, shape="<geometry><sphere><radius>2</radius></sphere></geometry>"), "model 'm' is a <sphere>"),
        (model(0, 8, shape="<geometry><mesh><uri>a.dae</uri></mesh></geometry>"), "model 'm' is a <mesh>"),
        (model(0, 8, shape="<geometry><heightmap/></geometry>"), "model 'm' is a <heightmap>"),
        (model(0, 8, shape="<geometry/>"), "has 0 shapes"),
        ("<include><uri>model://jersey_barrier</uri></include>", "includes 'model://jersey_barrier'"),
        ("<actor name='a'/>", "<actor> could stand in the robot's way"),
        ("<fence/>", "<fence> in <world> is unknown"),
        (model(0, 8).replace("<link", "<fence/><link"), "<fence> in <model> is unknown"),
        (model(0, 8).replace("<pose>", "<pose relative_to='x'>", 1), "<pose relative_to=…> of model 'm'"),
        (model(0, 8, link="<pose>0 0 0 0.3 0 0</pose>"), "link 'l' is tilted"),
        (model(0, 8, link="<pose>0 0 3 0 0 0</pose>"), "reaches from 2.5 to 3.5 m"),
        (model(0, 8).replace("<radius>0.1</radius>", ""), "lacks its <radius>"),
        (model(0, 8).replace("</model>", model(1, 1) + "</model>"), "holds a <model>"),
        (GROUND.replace("<pose>0 0 0 ", "<pose>0 0 1 "), "a plane that is not the ground"),
        ("<model name='v'><link name='l'><visual name='v'/></link></model>", "seen but cannot be touched"),
        ("", "holds no cylinder"),
        (model(0, 8, collision="<pose>0 0 0 0 0 0</pose><pose>1 0 0 0 0 0</pose>"), "a second <pose> in collision 'c'"),
        (model(0, 8).replace("<model name='m'>", "<model name='m' placement_frame='f'>"), "placement_frame of model"),
        (
            model(0, 8) + "<state><insertions><model name='b'/></insertions></state>",
            "<model> in <insertions> is unknown",
        ),
        (model(0, 8) + model(1, 8) + "<state><model name='m'/></state>", "two models have one name"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name_and_line(text: str, sentence: str) -> None:
    with pytest.raises(UserError, match=r"a\.world") as caught:
        read(text)
    assert sentence in str(caught.value)
