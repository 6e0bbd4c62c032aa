import json

import imageio.v3 as iio
import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from icub_core.data import Instance
from icub_core.geometry import is_rigid
from icub_core.hooks import Events, listen
from icub_core.interfaces.task import RUNNING, SUCCESS
from icub_core.scene import Geom, ObjectSpec
from icub_pipelines.grasping import Announcer
from icub_pipelines.images import contact_sheet, draw_instances, save_animation, save_image
from icub_pipelines.report import write_report
from icub_pipelines.tabletop import scatter, standing_pose
from icub_support.appearance import random_lights, random_surface


def box(name, x, y, z):
    return ObjectSpec(name, (Geom("box", (x, y, z)),), mass=0.1, half_extents=(x, y, z), rest_height=z)


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_scattered_objects_never_overlap(seed):
    rng = np.random.default_rng(seed)
    specs = [box(f"b{i}", *rng.uniform(0.02, 0.06, 3)) for i in range(7)]
    places = scatter(specs, (-0.4, 0.0), 0.25, rng)
    radius = {s.name: np.hypot(*s.half_extents[:2]) for s in specs}
    names = list(places)
    for i, first in enumerate(names):
        assert np.all(np.abs(np.subtract(places[first], (-0.4, 0.0))) <= 0.25)
        for second in names[:i]:
            assert np.hypot(*np.subtract(places[first], places[second])) > radius[first] + radius[second]


@given(st.floats(-7, 7))
def test_a_standing_object_touches_the_table_whatever_its_yaw(yaw):
    T = standing_pose(box("b", 0.03, 0.02, 0.08), -0.3, 0.1, 0.95, yaw)
    assert is_rigid(T)
    np.testing.assert_allclose(T[:3, 3], [-0.3, 0.1, 1.03])
    np.testing.assert_allclose(T[2, 2], 1.0)


def test_rooms_differ_by_seed_and_repeat_by_seed():
    first, again, other = (random_surface(np.random.default_rng(s)).texture for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    lights = random_lights(np.random.default_rng(3))
    assert all(light.direction[2] < 0 for light in lights), "lamps shine downwards"
    assert np.sum([light.diffuse for light in lights], axis=0).max() < 1, "lamps do not overexpose"


def test_images_can_be_read_back(tmp_path):
    mask = np.zeros((60, 80), bool)
    mask[10:30, 20:50] = True
    image = np.full((60, 80, 3), 90, np.uint8)
    drawn = draw_instances(image, [Instance.from_mask("mug", mask, score=0.7)])
    assert np.all(image == 90), "the input is not drawn on"
    assert not np.array_equal(drawn[mask], image[mask])
    sheet = contact_sheet([drawn] * 5, columns=4)
    assert sheet.shape == (120, 320, 3)
    save_image(tmp_path / "sheet.png", sheet)
    assert np.array_equal(iio.imread(tmp_path / "sheet.png"), sheet)
    save_animation(tmp_path / "video.gif", [image, drawn, image], frames_per_second=10)
    assert len(iio.imread(tmp_path / "video.gif", index=None)) >= 2


class EpisodeListener:
    def __init__(self):
        self.heard = []

    @listen
    def icub_episode_start(self, episode, seed):
        self.heard.append(("start", episode, seed))

    @listen
    def icub_step(self, reward, action):
        self.heard.append(("step", reward, tuple(action.shape)))

    @listen
    def icub_episode_end(self, episode, success, steps, reason):
        self.heard.append(("end", episode, success, steps, reason))


def test_listeners_hear_episodes_and_their_steps():
    listener = EpisodeListener()
    announce = Announcer(Events([listener]), 5, ("running", "success", "fell"))
    for reward, reason in ((0.0, RUNNING), (2.0, SUCCESS)):
        step = {"action": torch.zeros(15), "reward": torch.tensor([reward]), "reason": torch.tensor([reason])}
        announce.record(3, TensorDict(step, []))
    assert listener.heard == [
        ("start", 3, 5), ("step", 0.0, (15,)), ("step", 2.0, (15,)), ("end", 3, True, 2, "success"),
    ]  # fmt: skip


def test_report_is_one_file_with_escaped_text(tmp_path):
    save_image(tmp_path / "p.png", np.zeros((4, 4, 3), np.uint8))
    write_report(
        tmp_path, "run", {"a": 0.5, "b": 3}, {"teach": 1.0}, [("p", tmp_path / "p.png")], ["<b>note</b>"], "x: 1"
    )
    text = (tmp_path / "report.html").read_text()
    assert "data:image/png;base64," in text
    assert "&lt;b&gt;note" in text
    assert "src='p.png'" not in text
    assert json.dumps(0.5) in text
