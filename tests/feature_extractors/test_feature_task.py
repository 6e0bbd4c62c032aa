"""The rendered pre-training set: repeatable, exactly annotated, and without the objects that are taught later."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.errors import DataError
from icub_datasets.feature_task import cache
from icub_datasets.feature_task.augment import augment, copy_paste
from icub_datasets.feature_task.objects import (
    YCB_SIZES,
    feature_task_objects,
    read_obj,
    resembles_ycb,
)
from icub_datasets.feature_task.renderer import MIN_PIXELS, FeatureTaskRenderer, LabeledImage
from icub_datasets.feature_task.task import FeatureTask
from icub_datasets.feature_task.textures import background_texture, product_texture

FEW = {"meshes": 6, "products": 8}


@pytest.fixture(scope="module")
def renderer():
    with FeatureTaskRenderer(**FEW) as made:
        yield made


def frame_with_objects(renderer, start=0):
    for seed in range(start, start + 50):
        image = renderer.render([99, seed])
        if len(image.labels) >= 2:
            return image
    raise AssertionError("no frame with two objects among fifty")


@pytest.fixture(scope="module")
def objects():
    return feature_task_objects()


@pytest.mark.pybullet
def test_at_least_eighty_meshes_and_unique_names(objects):
    assert sum(item.parts[0].mesh is not None for item in objects) >= 80
    assert len({item.name for item in objects}) == len(objects) == FeatureTask().label_count


@pytest.mark.pybullet
def test_sizes_are_those_of_table_top_objects(objects):
    longest = np.array([item.extents.max() for item in objects])
    assert longest.min() > 0.04
    assert longest.max() < 0.26
    meshes = np.array([item.extents.max() for item in objects if item.parts[0].mesh is not None])
    assert meshes.min() >= 0.09 - 1e-9
    assert meshes.max() <= 0.20 + 1e-9


@pytest.mark.pybullet
def test_no_class_has_the_size_of_an_object_that_is_taught_later(objects):
    for item in objects:
        mine = np.sort(item.extents)
        for name, size in YCB_SIZES.items():
            apart = np.abs(mine - np.sort(size)) / np.sort(size)
            assert apart.max() > 0.12, f"{item.name} could be taken for {name}"


@given(st.sampled_from(sorted(YCB_SIZES)), st.permutations([0, 1, 2]), st.floats(0.95, 1.05))
def test_a_ycb_sized_box_is_recognized_in_any_orientation(name, order, scale):
    size = np.array(YCB_SIZES[name])[list(order)] * scale
    assert resembles_ycb(size) is not None


@pytest.mark.pybullet
def test_objects_of_a_seed_are_always_the_same(objects):
    again = feature_task_objects()
    assert [item.name for item in again] == [item.name for item in objects]
    assert all(np.array_equal(a.points, b.points) for a, b in zip(again, objects, strict=True))


def test_an_obj_file_is_read_with_all_its_shapes(tmp_path):
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    file = tmp_path / "two.obj"
    file.write_text(f"o a\n{corners}f 1 2 3\nf 1/1 2/2 4/4\no b\n{corners}f 5 6 7\nf 5//1 6//1 8//1\n")
    vertices, faces = read_obj(file)
    assert vertices.shape == (8, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 1, 3], [4, 5, 6], [4, 5, 7]]


def test_an_obj_file_without_a_mesh_is_named(tmp_path):
    file = tmp_path / "empty.obj"
    file.write_text("# nothing\n")
    with pytest.raises(DataError, match=r"empty\.obj.*0 vertices"):
        read_obj(file)


def test_textures_have_the_promised_shape_and_depend_on_the_seed_only():
    for draw, shape in ((product_texture, (6 * 32, 32, 3)), (background_texture, (32, 32, 3))):
        first, same, other = (draw(np.random.default_rng(s), 32) for s in (5, 5, 6))
        assert first.shape == shape
        assert first.dtype == np.uint8
        assert np.array_equal(first, same)
        assert not np.array_equal(first, other)


@pytest.mark.pybullet
def test_a_frame_depends_on_its_seed_only(renderer):
    first = renderer.render([1, 2, 3])
    renderer.render([4])  # leaves other poses, lamps and materials behind
    again = renderer.render([1, 2, 3])
    assert np.array_equal(first.rgb, again.rgb)
    assert np.array_equal(first.instances, again.instances)


@pytest.mark.pybullet
def test_masks_are_exactly_the_pixels_of_the_objects(renderer):
    """Hiding an object's geometry changes the segmentation inside its mask only, and removes it there."""
    image = frame_with_objects(renderer)
    model, data = renderer._model, renderer._data
    for index, label in enumerate(image.labels, start=1):
        geoms = renderer._classes[:-1] == label
        groups = model.geom_group.copy()
        model.geom_group[geoms] = 5
        renderer._renderer.update_scene(data, camera=0)
        renderer._renderer.enable_segmentation_rendering()
        segments = renderer._renderer.render()
        renderer._renderer.disable_segmentation_rendering()
        model.geom_group[:] = groups
        classes = renderer._classes[np.where(segments[..., 1] == 5, segments[..., 0], -1)]
        assert not (classes == label).any()
        known = np.concatenate([[0], image.labels])[image.instances]
        outside = image.instances != index
        kept = outside & (image.instances > 0)
        assert np.array_equal(classes[kept], known[kept])


@pytest.mark.pybullet
def test_object_colors_appear_where_the_mask_says(renderer):
    """With all lamps' shadows gone, hiding an object changes colors inside its mask and little elsewhere."""
    image = frame_with_objects(renderer)
    model = renderer._model
    cast = model.light_castshadow.copy()
    groups = model.geom_group.copy()
    model.light_castshadow[:] = 0
    renderer._renderer.update_scene(renderer._data, camera=0)
    with_object = renderer._renderer.render().astype(int)
    largest = int(np.bincount(image.instances.ravel())[1:].argmax())
    model.geom_group[renderer._classes[:-1] == image.labels[largest]] = 5
    renderer._renderer.update_scene(renderer._data, camera=0)
    without = renderer._renderer.render().astype(int)
    model.light_castshadow[:], model.geom_group[:] = cast, groups
    changed = np.abs(with_object - without).max(axis=2) > 12
    inside = image.instances == largest + 1
    assert changed[inside].mean() > 0.6
    # one pixel of border: colors are smoothed by multisampling, the masks are not
    from scipy.ndimage import binary_dilation

    assert not (changed & ~binary_dilation(inside, iterations=2)).any()


@pytest.mark.pybullet
def test_frames_show_objects_at_many_sizes(renderer):
    areas = np.concatenate([np.bincount(renderer.render([7, s]).instances.ravel())[1:] for s in range(15)])
    assert len(areas) > 20
    assert areas.min() >= MIN_PIXELS
    assert np.percentile(areas, 90) > 4 * np.percentile(areas, 10)


@pytest.fixture(scope="module")
def images(renderer):
    return [frame_with_objects(renderer), frame_with_objects(renderer, 100)]


@pytest.mark.pybullet
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_augmentation_keeps_labels_and_masks_together(images, seed):
    rng = np.random.default_rng(seed)
    before = [(p.rgb.copy(), p.instances.copy()) for p in images]
    out = augment(rng, *images)
    assert out.rgb.shape == images[0].rgb.shape
    assert out.rgb.dtype == np.uint8
    counts = np.bincount(out.instances.ravel(), minlength=len(out.labels) + 1)
    assert len(counts) == len(out.labels) + 1
    assert (counts[1:] >= MIN_PIXELS).all()
    assert set(out.labels) <= set(images[0].labels) | set(images[1].labels)
    for picture, (rgb, instances) in zip(images, before, strict=True):
        assert np.array_equal(picture.rgb, rgb)
        assert np.array_equal(picture.instances, instances)


def test_a_pasted_object_has_its_color_under_its_mask():
    height, width = 240, 320
    red = np.zeros((height, width, 3), np.uint8)
    instances = np.zeros((height, width), np.uint8)
    red[100:150, 100:160] = (255, 0, 0)
    instances[100:150, 100:160] = 1
    source = LabeledImage(red, instances, np.array([7]))
    empty = LabeledImage(np.zeros_like(red), np.zeros_like(instances), np.zeros(0, np.int64))
    out = copy_paste(np.random.default_rng(0), empty, source)
    assert out.labels.tolist() == [7]
    inside = out.instances == 1
    assert (out.rgb[inside, 0] > 127).mean() > 0.9
    assert not out.rgb[~inside, 1:].any()


def test_the_cache_gives_back_what_was_rendered_and_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "SHARD_FRAMES", 2)
    rng = np.random.default_rng(0)
    frames = [
        LabeledImage(
            np.full((240, 320, 3), v, np.uint8),
            np.where(rng.random((240, 320)) < 0.5, 1, 2).astype(np.uint8),
            np.array([v, v + 1]),
        )
        for v in (10, 90)
    ]
    cache._write_shard(cache._shard_path(tmp_path, "train", 0), frames)
    read = cache.FeatureTaskFrames(tmp_path, "train", 1)
    assert len(read) == 2
    for i, frame in enumerate(frames):
        assert np.array_equal(read[i].instances, frame.instances)
        assert np.array_equal(read[i].labels, frame.labels)
        assert np.abs(read[i].rgb.astype(int) - frame.rgb).max() <= 2  # JPEG
    stamp = cache._shard_path(tmp_path, "train", 0).stat().st_mtime_ns
    rendered = []
    monkeypatch.setattr(cache.multiprocessing, "get_context", lambda kind: pytest.fail("nothing was missing"))
    cache.generate(tmp_path, "train", 2, progress=lambda a, b: rendered.append((a, b)))
    assert cache._shard_path(tmp_path, "train", 0).stat().st_mtime_ns == stamp


def test_a_damaged_or_missing_shard_is_named(tmp_path):
    with pytest.raises(DataError, match="lacks 1 of 1 shards.*prepare"):
        FeatureTask(tmp_path, frames=100).labeled(0)
    (tmp_path / "train_0000.npz").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(DataError, match=r"train_0000\.npz"):
        FeatureTask(tmp_path, frames=100).labeled(0)


def test_a_folder_of_another_seed_is_refused(tmp_path):
    (tmp_path / "recipe.json").write_text(json.dumps({"seed": 3, "version": 1}))
    with pytest.raises(DataError, match="another folder"):
        FeatureTask(tmp_path, frames=100).prepare()


def test_unknown_split_and_empty_set_are_refused():
    with pytest.raises(DataError, match="validation"):
        FeatureTask(split="test")
    with pytest.raises(DataError, match="at least 1"):
        FeatureTask(frames=0)


@pytest.mark.pybullet
@pytest.mark.slow
def test_generation_resumes_and_both_splits_differ(tmp_path):
    task = FeatureTask(tmp_path, frames=200)
    task.prepare()
    kept = (tmp_path / "train_0000.npz").stat().st_mtime_ns
    first = task.labeled(150).rgb
    (tmp_path / "train_0001.npz").unlink()
    again = FeatureTask(tmp_path, frames=200)
    again.prepare()
    assert (tmp_path / "train_0000.npz").stat().st_mtime_ns == kept
    assert np.array_equal(again.labeled(150).rgb, first)
    unseen = FeatureTask(tmp_path, "validation", frames=100)
    unseen.prepare()
    assert not np.array_equal(unseen.labeled(0).rgb, task.labeled(0).rgb)
    frame, instances = unseen[0]
    assert frame.rgb.shape == (240, 320, 3)
    assert {i.label for i in instances} <= set(unseen.classes)
