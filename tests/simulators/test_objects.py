"""What the object sets promise."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.errors import ConfigError, DataError
from icub_core.geometry import make_transform, quat_wxyz_to_matrix, rotation_exp
from icub_core.scene import Geom, ObjectSpec, Scene
from icub_simulators.decimation import decimate
from icub_simulators.mujoco.simulator import Mujoco
from icub_simulators.objects.folder import Folder
from icub_simulators.objects.household.object_set import KINDS, Household
from icub_simulators.objects.meshes import count_faces, read_mesh
from icub_simulators.objects.random1000 import Random1000
from icub_simulators.objects.resting import drop
from icub_simulators.objects.solids import center_of_mass, hull_volume, narrowest_width, rest_pose, stable_poses
from icub_simulators.objects.textures import PATTERNS, print_texture
from icub_simulators.objects.ycb_primitives import YcbPrimitives
from icub_testing.checks import checks

PUBLISHED = {  # meters and kilograms, from the YCB project's table
    "003_cracker_box": ((0.060, 0.158, 0.210), 0.411),
    "004_sugar_box": ((0.038, 0.089, 0.175), 0.514),
    "005_tomato_soup_can": ((0.066, 0.066, 0.101), 0.349),
    "006_mustard_bottle": ((0.058, 0.095, 0.190), 0.603),
    "008_pudding_box": ((0.035, 0.110, 0.089), 0.187),
    "010_potted_meat_can": ((0.050, 0.097, 0.082), 0.370),
    "021_bleach_cleanser": ((0.065, 0.098, 0.250), 1.131),
    "035_power_drill": ((0.184, 0.057, 0.187), 0.895),
}


@pytest.fixture(autouse=True, scope="module")
def private_cache(tmp_path_factory):
    """What is computed here is not taken from, nor left in, the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def folder(tmp_path):
    """Build an object folder from meshes by name."""

    def build(**meshes):
        for name, mesh in meshes.items():
            path = tmp_path / f"{name}.obj"
            path.write_text(mesh if isinstance(mesh, str) else trimesh.exchange.obj.export_obj(mesh))
        return Folder(tmp_path)

    return build


@pytest.mark.parametrize("name", list(checks("objects")))
@pytest.mark.parametrize("make", [YcbPrimitives, Household, pytest.param(Random1000, marks=pytest.mark.pybullet)])
def test_contract(make, name):
    checks("objects")[name](make)


@pytest.mark.parametrize("name", list(checks("objects")))
def test_contract_of_folders(name, folder):
    folder(cup=trimesh.creation.capsule(0.1, 0.03), block=trimesh.creation.box((0.05, 0.06, 0.1)))
    checks("objects")[name](lambda: folder())


def bounds(spec):
    """Half extents of the pieces, from their own sizes and poses."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for piece in spec.collision:
        R = quat_wxyz_to_matrix(piece.quat_wxyz)
        if piece.shape == "box":
            reach = np.abs(R) @ np.array(piece.size)
        else:
            radius, half = piece.size
            axis = R[:, 2]
            reach = half * np.abs(axis) + radius * np.sqrt(np.clip(1 - axis**2, 0, 1))
        low = np.minimum(low, np.array(piece.position) - reach)
        high = np.maximum(high, np.array(piece.position) + reach)
    return low, high


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_ycb_sizes_and_masses_are_the_published_ones(name):
    spec = YcbPrimitives().get(name)
    size, mass = PUBLISHED[name]
    low, high = bounds(spec)
    np.testing.assert_allclose(high - low, size, atol=1e-9)
    np.testing.assert_allclose(high + low, 0, atol=1e-9)
    np.testing.assert_allclose(np.array(spec.half_extents) * 2, size)
    assert spec.mass == mass
    standing = np.abs(quat_wxyz_to_matrix(spec.rest_quat_wxyz)) @ np.array(spec.half_extents)
    assert spec.rest_height == pytest.approx(standing[2])


def test_ycb_holds_the_eight_of_the_thesis():
    assert YcbPrimitives().names == tuple(PUBLISHED)


@pytest.mark.pybullet
def test_random_objects_are_all_there_but_the_broken_one():
    names = Random1000().names
    assert len(names) == 999
    assert "random_168" not in names
    with pytest.raises(ConfigError, match="random_007"):
        Random1000().get("random_7")


@pytest.mark.pybullet
def test_random_objects_have_their_true_size_unless_asked():
    spec = Random1000().get("random_000")
    assert spec.mass == 0.1
    lengths = [max(Random1000([0.1, 0.12]).get(f"random_{i:03d}").half_extents) * 2 for i in range(12)]
    assert all(0.1 <= length <= 0.12 for length in lengths)
    assert len(set(lengths)) == 12
    with pytest.raises(ConfigError, match="size"):
        Random1000([0.2, 0.1])


def tilts_after_a_nudge(pieces, rest):
    """Degrees between `rest` (3, 3) and where the body ends that is let go 4 degrees from it, in six directions."""
    axes = np.radians(4.0) * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(6) * np.pi / 3])
    ends, settled = drop(pieces, np.array([rotation_exp(axis) @ rest for axis in axes]))
    assert settled.all()
    return np.degrees(np.arccos(np.clip(ends[:, 2] @ rest[2], -1, 1)))


@pytest.mark.pybullet
@pytest.mark.slow
def test_graspable_random_objects_fit_the_hand_and_stand_firmly():
    objects = Random1000(graspable=True)
    assert len(objects.names) >= 200
    for name in objects.names[::10]:
        spec = objects.get(name)
        pieces = [np.asarray(trimesh.load(piece.mesh).vertices) for piece in spec.collision]
        points = np.concatenate(pieces)
        assert tilts_after_a_nudge(pieces, quat_wxyz_to_matrix(spec.rest_quat_wxyz)).max() < 3.0
        standing = points @ quat_wxyz_to_matrix(spec.rest_quat_wxyz).T
        assert 0.039 < narrowest_width(standing[:, :2]) < 0.063
        assert 0.049 < np.ptp(standing[:, 2]) < 0.251
        assert 0.069 < np.ptp(points, axis=0).max() < 0.221
        assert -standing[:, 2].min() == pytest.approx(spec.rest_height, abs=1e-6)


@pytest.mark.pybullet
@pytest.mark.slow
def test_random_objects_return_to_their_computed_pose():
    """Nearly all of them: some have no pose that withstands 4 degrees."""
    objects = Random1000([0.08, 0.16])
    specs = [objects.get(name) for name in objects.names[::25]]
    pieces = [[np.asarray(trimesh.load(piece.mesh).vertices) for piece in spec.collision] for spec in specs]
    tilts = [
        tilts_after_a_nudge(p, quat_wxyz_to_matrix(spec.rest_quat_wxyz)).max()
        for p, spec in zip(pieces, specs, strict=True)
    ]
    assert np.mean(np.array(tilts) < 5.0) >= 0.95


@pytest.mark.pybullet
def test_random_objects_rest_where_they_are_put(standing):
    objects = Random1000([0.09, 0.15])
    specs = [objects.get(name) for name in objects.names[:12]]
    simulator = Mujoco()
    simulator.load(None, Scene(objects=tuple(specs)))
    poses = {s.name: standing(s, -0.4 - 0.3 * (i % 2), -0.8 + 0.14 * i) for i, s in enumerate(specs)}
    for name, pose in poses.items():
        simulator.set_object_pose(name, pose)
    simulator.step(200)
    upright = [simulator.object_pose(name)[:3, 2] @ pose[:3, 2] for name, pose in poses.items()]
    simulator.close()
    assert np.mean(np.array(upright) > np.cos(0.1)) >= 0.9


def household_pieces(spec):
    return [np.asarray(trimesh.load(piece.mesh, process=False).vertices) for piece in spec.collision]


def test_household_things_have_the_length_that_is_asked_for():
    things = Household()
    assert len(things.names) == 8 * len(KINDS) >= 100
    asked = Household([0.1, 0.12])
    lengths = [2 * max(asked.get(name).half_extents) for name in things.names[::7]]
    assert all(0.1 - 1e-9 <= length <= 0.12 + 1e-9 for length in lengths)
    assert len(set(lengths)) == len(lengths)
    assert all(0.06 < 2 * max(things.get(name).half_extents) < 0.27 for name in things.names)
    with pytest.raises(ConfigError, match="size"):
        Household([0.2, 0.1])


def test_no_household_thing_has_a_shape_of_a_training_set():
    """Training sets hold boxes, cylinders and ellipsoids: convex, and 1, pi/4 and pi/6 of the box around them."""
    for name in Household().names:
        spec = Household().get(name)
        pieces = household_pieces(spec)
        assert len(pieces) >= 2, name
        hull = hull_volume(np.concatenate(pieces))
        unlike = min(abs(hull / (8 * np.prod(spec.half_extents)) - share) for share in (1.0, np.pi / 4, np.pi / 6))
        hollows = 1 - sum(hull_volume(p) for p in pieces) / hull
        assert max(unlike, hollows) > 0.02, name


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_household_things_stay_as_they_are_put(kind, standing):
    specs = [Household([0.08, 0.2]).get(f"{kind}_{i}") for i in range(8)]
    simulator = Mujoco()
    simulator.load(None, Scene(objects=tuple(specs)))
    poses = {spec.name: standing(spec, -0.5, -0.85 + 0.24 * i) for i, spec in enumerate(specs)}
    for name, pose in poses.items():
        simulator.set_object_pose(name, pose)
    simulator.step(200)
    for name, pose in poses.items():
        moved = simulator.object_pose(name)
        assert np.arccos(min(moved[2, :3] @ pose[2, :3], 1.0)) < np.radians(3), name
        assert np.linalg.norm(moved[:3, 3] - pose[:3, 3]) < 0.01, name
    simulator.close()


def test_vessels_are_hollow():
    """A small ball falls to the bottom of a mug, whose pieces surround it."""
    spec = Household().get("mug_0")
    points = np.concatenate(household_pieces(spec))
    ball = ObjectSpec("ball", (Geom("sphere", (0.008,)),), 0.01, (0.008,) * 3, 0.008)
    simulator = Mujoco()
    simulator.load(None, Scene(objects=(spec, ball)))
    simulator.set_object_pose("mug_0", make_transform(None, [-0.4, 0.0, 0.95 + spec.rest_height]))
    wall = points[np.abs(points[:, 1]) < 1e-3, 0].min()  # the ear is on the other side
    simulator.set_object_pose("ball", make_transform(None, [-0.4 + wall + 0.025, 0.0, 1.1]))
    simulator.step(200)
    assert simulator.object_pose("ball")[2, 3] < 0.95 + 0.03
    assert simulator.object_pose("mug_0")[2, 2] > np.cos(0.05)
    simulator.close()


def test_surfaces_of_household_things_are_closed_and_hold_their_pieces():
    for name in Household().names[::8]:
        spec = Household().get(name)
        (drawn,) = spec.visual
        surface = trimesh.load(drawn.mesh, process=False)
        assert surface.is_watertight, name
        assert surface.volume > 0, name
        pieces = np.concatenate(household_pieces(spec))
        np.testing.assert_allclose(surface.bounds, [pieces.min(axis=0), pieces.max(axis=0)], atol=1e-6)


def l_shape():
    """Two walls, 3 cm thick: 204 cubic centimeters."""
    outline = np.array([[0, 0], [0.1, 0], [0.1, 0.03], [0.03, 0.03], [0.03, 0.1], [0, 0.1]])
    vertices = np.concatenate([np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, 0.04)]])
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(a, c, b) for a, b, c in caps] + [(a + 6, b + 6, c + 6) for a, b, c in caps]
    for i, j in ((i, (i + 1) % 6) for i in range(6)):
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    return trimesh.Trimesh(vertices, np.array(faces), process=False)


def test_a_mesh_is_decomposed_once(folder, monkeypatch):
    first = folder(corner=l_shape()).get("corner")
    assert len(first.collision) == 2  # its hull would fill the corner
    monkeypatch.setattr("coacd.run_coacd", lambda *a, **k: pytest.fail("decomposed again"))
    second = folder().get("corner")
    assert [p.mesh for p in first.collision] == [p.mesh for p in second.collision]
    volume = sum(hull_volume(np.asarray(trimesh.load(p.mesh).vertices)) for p in first.collision)
    assert volume == pytest.approx(2.04e-4, rel=0.03)
    assert first.mass == pytest.approx(500 * volume, rel=1e-6)
    np.testing.assert_allclose(trimesh.load(first.visual[0].mesh).volume, 2.04e-4, rtol=1e-3)


def test_a_convex_mesh_is_not_decomposed(folder, monkeypatch):
    monkeypatch.setattr("coacd.run_coacd", lambda *a, **k: pytest.fail("decomposed a ball"))
    spec = folder(ball=trimesh.creation.icosphere(2, radius=0.03)).get("ball")
    assert len(spec.collision) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n", "not finite"),
        ("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv .1 .1 0\nf 1 2 3\nf 2 4 3\n", "flat"),
        ("v 0 0 0\nv 90 0 0\nv 0 90 0\nv 0 0 90\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n", "scale=0.001"),
    ],
)
def test_broken_meshes_are_one_clear_line(folder, content, message):
    objects = folder(thing=content)
    with pytest.raises(DataError, match=message) as caught:
        objects.get("thing")
    assert "thing.obj" in str(caught.value)
    assert "\n" not in str(caught.value)


def write_two_boxes(path):
    """One OBJ with two shapes, 2 cm cubes 6 cm apart; MuJoCo's own reader keeps the first only."""
    text, count = "", 0
    for name, x in (("left", -0.03), ("right", 0.03)):
        box = trimesh.creation.box(extents=(0.02, 0.02, 0.02))
        text += f"o {name}\n" + "".join(f"v {a + x} {b} {c}\n" for a, b, c in box.vertices)
        text += "".join(f"f {a + count + 1} {b + count + 1} {c + count + 1}\n" for a, b, c in box.faces)
        count += len(box.vertices)
    path.write_text(text)


URDF = """<robot name="thing"><link name="base">
  <inertial><mass value="0.3"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><mesh filename="parts/two.obj"/></geometry></visual>
  <collision><origin xyz="0 0 0.04" rpy="0 0 1.5707963"/>
  <geometry><mesh filename="parts/two.obj"/></geometry></collision>
  <collision><geometry><box size="0.02 0.02 0.06"/></geometry></collision></link>{joint}</robot>"""
HINGE = """<link name="lid"><inertial><mass value="0.1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0"
  iyz="0"/></inertial></link><joint name="hinge" type="continuous"><parent link="base"/><child link="lid"/></joint>"""


def test_no_shape_of_a_file_is_lost(tmp_path):
    write_two_boxes(tmp_path / "two.obj")
    spec = Folder(tmp_path).get("two")
    np.testing.assert_allclose(spec.half_extents, (0.04, 0.01, 0.01), atol=1e-4)
    assert len(spec.collision) == 2
    assert spec.mass == pytest.approx(500 * 2 * 0.02**3, rel=0.05)


def test_a_urdf_is_one_object(tmp_path):
    (tmp_path / "parts").mkdir()
    write_two_boxes(tmp_path / "parts" / "two.obj")
    (tmp_path / "thing.urdf").write_text(URDF.format(joint=""))
    objects = Folder(tmp_path)
    assert objects.names == ("thing",)
    spec = objects.get("thing")
    assert spec.mass == pytest.approx(0.3)
    assert len(spec.collision) == 3
    np.testing.assert_allclose(spec.half_extents, (0.01, 0.04, 0.04), atol=1e-3)  # z: -0.03 to 0.05


def test_an_mjcf_file_is_one_object(tmp_path):
    (tmp_path / "cup.xml").write_text(
        '<mujoco><worldbody><body><freejoint/><geom type="cylinder" size="0.03 0.05" density="1000"/>'
        '<geom type="box" size="0.005 0.02 0.02" pos="0.035 0 0" density="1000"/></body></worldbody></mujoco>'
    )
    spec = Folder(tmp_path, density=1000.0).get("cup")
    assert len(spec.collision) == 2
    np.testing.assert_allclose(spec.half_extents, (0.035, 0.03, 0.05), atol=1e-3)
    assert spec.mass == pytest.approx(1000 * (np.pi * 0.03**2 * 0.1 + 0.01 * 0.04 * 0.04), rel=0.02)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("lid.urdf", URDF.format(joint=HINGE), "movable joint 'hinge'"),
        ("lost.urdf", URDF.format(joint=""), "two.obj"),
        ("bad.xml", "<mujoco><worldbody>", "cannot be read"),
        ("none.xml", "<mujoco><worldbody><body/></worldbody></mujoco>", "no shape"),
    ],
)
def test_model_files_that_cannot_be_used_are_one_clear_line(tmp_path, name, content, message):
    if name == "lid.urdf":
        (tmp_path / "parts").mkdir()
        write_two_boxes(tmp_path / "parts" / "two.obj")
    (tmp_path / name).write_text(content)
    with pytest.raises(DataError, match=message) as caught:
        Folder(tmp_path).get(name.partition(".")[0])
    assert "\n" not in str(caught.value)


def test_ten_million_faces_are_refused_before_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr("trimesh.load", lambda *a, **k: pytest.fail("read"))
    with (tmp_path / "binary.stl").open("wb") as file:
        file.write(bytes(80) + (10_000_000).to_bytes(4, "little"))
        file.truncate(84 + 50 * 10_000_000)  # a sparse file
    monkeypatch.setattr("icub_simulators.objects.meshes.MAX_FACES", 20_000)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    (tmp_path / "text.obj").write_text(corners + "f 1 2 3\n" * 20_001)
    (tmp_path / "text.stl").write_text("solid x\n" + "facet normal 0 0 1\n" * 20_001)
    for file, count in (("binary.stl", 10_000_000), ("text.obj", 20_001), ("text.stl", 20_001)):
        with pytest.raises(DataError, match=f"{file} has {count} faces; expected at most 20000") as caught:
            read_mesh(tmp_path / file)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("chunk", [5, 16, 1 << 24])
def test_faces_are_counted_wherever_the_file_is_cut(tmp_path, monkeypatch, chunk):
    monkeypatch.setattr("icub_simulators.objects.meshes._CHUNK", chunk)
    ball = trimesh.creation.icosphere(1)
    for kind in ("obj", "stl", "stl_ascii"):
        path = tmp_path / f"{kind}.{kind[:3]}"
        ball.export(path, file_type=kind)
        assert count_faces(path) == len(ball.faces)


@pytest.mark.slow  # what is not closed is remeshed first
def test_a_mesh_that_is_not_watertight_is_used_as_it_is(folder):
    """A box without its lid: walls and a bottom, which convex pieces cover."""
    box = trimesh.creation.box((0.05, 0.06, 0.1))
    lid = box.triangles_center[:, 2] > 0.049
    open_box = trimesh.Trimesh(box.vertices, box.faces[~lid], process=False)
    assert not open_box.is_watertight
    spec = folder(open=open_box).get("open")
    np.testing.assert_allclose(spec.half_extents, (0.025, 0.03, 0.05), atol=2e-3)
    assert 0 < spec.mass < 500 * 0.05 * 0.06 * 0.1
    assert len(spec.collision) >= 5


def test_MILLIMETERS_are_read_with_the_scale(tmp_path):
    trimesh.creation.box((50, 60, 100)).export(tmp_path / "block.stl")
    spec = Folder(tmp_path, scale=0.001).get("block")
    np.testing.assert_allclose(spec.half_extents, (0.025, 0.03, 0.05), atol=1e-6)
    assert spec.mass == pytest.approx(500 * 0.05 * 0.06 * 0.1, rel=1e-3)
    assert spec.rest_height == pytest.approx(0.025, abs=1e-6)


def test_folders_that_cannot_be_used(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        Folder(tmp_path / "nowhere")
    with pytest.raises(DataError, match="no mesh"):
        Folder(tmp_path)
    (tmp_path / "cup.obj").write_text("v 0 0 0\n")
    with pytest.raises(ConfigError, match="scale"):
        Folder(tmp_path, scale=0)
    with pytest.raises(ConfigError, match="Did you mean 'cup'"):
        Folder(tmp_path).get("cap")


def test_a_mesh_that_vanished_is_named(folder, tmp_path):
    objects = folder(block=trimesh.creation.box((0.05, 0.06, 0.1)))
    (tmp_path / "block.obj").unlink()
    with pytest.raises(DataError, match="no mesh file"):
        objects.get("block")


def test_a_box_rests_on_its_largest_side():
    points = trimesh.creation.box((0.04, 0.09, 0.17)).vertices.view(np.ndarray)
    pose = rest_pose(points, np.zeros(3))
    assert pose.height == pytest.approx(0.02)
    assert [round(p.height, 3) for p, tilt in stable_poses(points, np.zeros(3)) if tilt > 0.1] == [
        0.02, 0.02, 0.045, 0.045, 0.085, 0.085,
    ]  # fmt: skip


def test_a_body_whose_weight_hangs_over_does_not_rest_there():
    points = trimesh.creation.box((0.04, 0.09, 0.17)).vertices.view(np.ndarray)
    heavy_edge = np.array([0.0, 0.044, 0.0])  # 1 mm inside one narrow side
    pose = rest_pose(points, heavy_edge)
    assert pose.height == pytest.approx(0.045)
    assert quat_wxyz_to_matrix(pose.quat_wxyz)[2, 1] == pytest.approx(-1)  # the heavy side is down
    tilts = [tilt for p, tilt in stable_poses(points, heavy_edge) if p.height == pytest.approx(0.02)]
    np.testing.assert_allclose(tilts, np.arctan2(0.001, 0.02))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_rest_poses_are_those_of_the_hull(seed):
    """The lowest point is on the table and the center of mass above the hull of what touches."""
    points = np.random.default_rng(seed).normal(size=(30, 3)) * [0.03, 0.05, 0.08]
    center = center_of_mass([points])
    pose = rest_pose(points, center)
    R = quat_wxyz_to_matrix(pose.quat_wxyz)
    height = (points @ R.T)[:, 2] + pose.height
    assert height.min() == pytest.approx(0, abs=1e-12)
    assert (height < 1e-9).sum() >= 3


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.01, 10), seed=st.integers(0, 1000))
def test_center_of_mass_moves_with_the_body(scale, seed):
    rng = np.random.default_rng(seed)
    points, shift = rng.normal(size=(12, 3)), rng.normal(size=3)
    center = center_of_mass([points])
    np.testing.assert_allclose(center_of_mass([scale * points + shift]), scale * center + shift, atol=1e-8)
    mesh = trimesh.convex.convex_hull(points)
    np.testing.assert_allclose(center, mesh.center_mass, atol=1e-8)


def test_decimation_stays_near_the_surface():
    ball = trimesh.creation.icosphere(5, radius=0.1)
    vertices, faces = decimate(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int64), 400)
    assert 100 < len(faces) <= 400
    radius = np.linalg.norm(vertices, axis=1)
    assert np.abs(radius - 0.1).max() < 2e-3
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(ball.volume, rel=0.1)


def test_decimation_keeps_a_box_a_box():
    box = trimesh.creation.box((0.1, 0.2, 0.3)).subdivide().subdivide().subdivide().subdivide()
    vertices, _ = decimate(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64), 300)
    np.testing.assert_allclose(np.abs(vertices).max(axis=0), [0.05, 0.1, 0.15], atol=1e-6)


def test_decimation_leaves_light_meshes_alone():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    _, faces = decimate(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64), 300)
    assert len(faces) == 12


@pytest.mark.parametrize("pattern", PATTERNS)
def test_prints_are_deterministic_and_show_both_colors(pattern):
    first = print_texture(pattern, (200, 30, 30), (20, 20, 220), 3)
    np.testing.assert_array_equal(first, print_texture(pattern, (200, 30, 30), (20, 20, 220), 3))
    assert first.dtype == np.uint8
    if pattern != "plain":
        blue = first[..., 2].astype(int) - first[..., 0] > 60
        red = first[..., 0].astype(int) - first[..., 2] > 60
        assert blue.mean() > 0.03
        assert red.mean() > 0.03
