"""Robots of other projects: URDF and MJCF files as robot files, their numbers against sums by hand, and refusals."""

import random
import re
import shutil
import struct
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sean_jax import robots
from sean_jax.cli import command_line
from sean_jax.core.errors import InputError
from sean_jax.core.messages import MAX_DEPTH
from sean_jax.io.files.meshes import MAX_ELEMENTS, rotation, vertices, xml_tree
from sean_jax.robots import foreign_links, importing, urdf_reading
from sean_jax.robots.importing import ImportSettings, import_robot
from support import robot_files
from support.checkout import ROOT
from support.fuzzing import check_error
from support.robot_files import BASE, CASTER, LASER, LIMIT, PAIR, joint, link, wheel, write_urdf

mujoco: Any = import_module("mujoco")  # which has no type stubs


def base_of(path, **settings):
    return importing._Base(path, importing._read(path), ImportSettings(**settings))


def loaded(base, tmp_path):
    out = tmp_path / "made.xml"
    out.write_text(base.mjcf("made"))
    return robots.load(out, "twin")


def test_a_pair_of_wheels(tmp_path):
    base = base_of(write_urdf(tmp_path, PAIR + CASTER + LASER))
    assert base.drive == "differential" and [w.name for w in base.wheels] == ["left_joint", "right_joint"]
    model = loaded(base, tmp_path)
    assert float(model.mass) == pytest.approx(8.0 + 2 * 0.5 + 0.2 + 0.5 + 0.1, rel=1e-5)
    assert float(model.wheel_radius) == pytest.approx(0.08) and float(model.track) == pytest.approx(0.4)
    assert float(model.max_speed) == pytest.approx(10 * 0.08)
    assert float(model.max_turn_rate) == pytest.approx(10 * 0.08 / 0.2)
    assert float(model.max_acceleration) == pytest.approx(2 * 3 / 0.08 / 9.8, rel=1e-4)
    # About the middle of the axle: each link's inertia, and its mass at its place.
    places = [
        (8.0, 0.02, 0.0),
        (0.5, 0.0, 0.2),
        (0.5, 0.0, -0.2),
        (0.2, -0.15, 0.0),
        (0.5, -0.15, 0.0),
        (0.1, 0.1, 0.0),
    ]
    inertia = sum(0.01 + mass * (x * x + y * y) for mass, x, y in places)
    assert float(model.inertia) == pytest.approx(inertia, rel=1e-4)
    assert float(model.radius) == pytest.approx(np.hypot(0.22, 0.15), rel=1e-3)  # a corner of the box
    (lidar,) = [mount for mount in model.mounts if mount.name == "lidar"]
    np.testing.assert_allclose(lidar.origin, [0.1, 0.0, 0.28], atol=1e-6)
    np.testing.assert_allclose(np.reshape(lidar.axes, (3, 3)), rotation(np.array([0, 0, 1.0]), 0.5), atol=1e-5)
    heights = np.asarray(model.solids.cylinders)[:, 2] - np.asarray(model.solids.cylinders)[:, 6]
    assert heights.min() >= -0.01  # nothing is below the floor but the caster's edge, which its radius puts there


def test_the_frame_follows_the_axle(tmp_path):
    """The same robot in a link that looks to the left: its forward is the direction across the axle."""
    turned = link("root", 0.0, "") + joint("mount", "base_link", "1 2 3", "root", "fixed", limit="", turn="0 0 1.1")
    parts = PAIR + LASER, turned + PAIR + LASER
    plain, away = (loaded(base_of(write_urdf(tmp_path, each)), tmp_path) for each in parts)
    for name in ("mass", "inertia", "track", "radius"):
        assert float(getattr(plain, name)) == pytest.approx(float(getattr(away, name)), rel=1e-5)
    np.testing.assert_allclose(plain.solids.boxes, away.solids.boxes, atol=1e-5)
    np.testing.assert_allclose(plain.mounts[0].origin, away.mounts[0].origin, atol=1e-5)


def test_four_wheels_drive_as_two(tmp_path):
    wheels = "".join(wheel(f"{x}{y}", f"{x} {y} 0") for x in (0.15, -0.15) for y in (0.2, -0.2))
    model = loaded(base_of(write_urdf(tmp_path, BASE + wheels), wheel_separation=0.5), tmp_path)
    assert float(model.track) == pytest.approx(0.5) and float(model.mass) == pytest.approx(10.0, rel=1e-5)
    assert len(model.solids.cylinders) == 4  # the two that stand for them are invisible


def pod(name, pose, kind="continuous"):
    """A wheel below a joint that steers."""
    steer = link(f"pod{name}", 0.1, "") + joint(f"pod{name}_joint", f"pod{name}", pose, axis="0 0 1", kind=kind)
    return steer + wheel(f"w{name}", "0 0 0", parent=f"pod{name}")


STEERED = pod("a", "0.3 0.2 0", "revolute") + pod("b", "0.3 -0.2 0", "revolute")
SWIVELS = "".join(pod(n, pose) for n, pose in enumerate(("0.2 0.2 0", "0.2 -0.2 0", "-0.2 0.2 0", "-0.2 -0.2 0")))
THREE = ""
for n, a in enumerate((0.3, 0.3 + 2 * np.pi / 3, 0.3 + 4 * np.pi / 3)):
    out = f"{np.cos(a)} {np.sin(a)} 0"
    THREE += wheel(f"w{n}", f"{0.2 * np.cos(a)} {0.2 * np.sin(a)} 0", '<sphere radius="0.05"/>', axis=out)
MECANUM = "".join(wheel(f"mecanum_{x}{y}", f"{x} {y} 0") for x in (0.15, -0.15) for y in (0.2, -0.2))


@pytest.mark.parametrize(
    ("parts", "drive"),
    [
        (PAIR + CASTER, "differential"),
        (PAIR + STEERED, "ackermann"),
        (BASE + SWIVELS, "omnidirectional"),
        (BASE + THREE, "omnidirectional"),
        (BASE + MECANUM, "omnidirectional"),
    ],
)
def test_the_drive_follows_from_the_wheels(parts, drive, tmp_path):
    base = base_of(write_urdf(tmp_path, parts))
    model = loaded(base, tmp_path)
    assert base.drive == drive == model.drive_type
    total = sum(each.mass for each in base.body.links)
    assert float(model.mass) == pytest.approx(total, rel=1e-5) and float(model.max_speed) > 0.4
    if drive == "ackermann":
        assert float(model.steering.wheelbase) == pytest.approx(0.3) and float(model.steering.max_angle) < 0.61
        # Between the axles where the mass is: the base and two wheels behind, two wheels with their joints ahead.
        center = (8.0 * 0.02 + 2 * (0.5 + 0.1) * 0.3) / total
        assert float(model.steering.rear_axle) == pytest.approx(center, rel=1e-4)
    if drive == "omnidirectional":
        assert float(model.lateral.max_speed) == float(model.max_speed)
    assert base_of(write_urdf(tmp_path, PAIR), drive="omnidirectional").drive == "omnidirectional"


def test_mjcf_with_a_freejoint(tmp_path):
    """Limits by actuators; the root stands somewhere else; the visual geom does not count."""
    path = tmp_path / "free.xml"
    path.write_text(robot_files.FREE_CART)
    base = base_of(path)
    model = loaded(base, tmp_path)
    assert [w.name for w in base.wheels] == ["l", "r"] and base.drive == "differential"
    assert float(model.max_speed) == pytest.approx(0.8) and float(model.mass) == pytest.approx(6.4, rel=1e-5)
    assert float(model.max_acceleration) == pytest.approx(2 * 2 / 0.1 / 6.4, rel=1e-4)
    origins = {mount.name: np.asarray(mount.origin) for mount in model.mounts}
    np.testing.assert_allclose(origins["lidar"], [0.1, 0.0, 0.3], atol=1e-5)
    np.testing.assert_allclose(origins["depth"], [0.2, 0.0, 0.4], atol=1e-5)
    assert not len(model.solids.spheres) and len(model.solids.cylinders) == 3
    # MuJoCo's own mass matrix of the file that is written.
    spec = mujoco.MjModel.from_xml_path(str(tmp_path / "made.xml"))
    data, full = mujoco.MjData(spec), np.zeros((5, 5))
    mujoco.mj_forward(spec, data)
    mujoco.mj_fullM(spec, data, full)
    assert full[0, 0] == pytest.approx(6.4, rel=1e-5) and np.abs(full - np.diag(np.diag(full))).max() < 1e-6
    about = 5 * (0.4**2 + 0.3**2) / 12 + 0.4 * 0.03**2 * 0.5 + 2 * 0.5 * (0.04 + (3 * 0.01 + 0.04**2) / 12)
    assert full[2, 2] == pytest.approx(about, rel=0.01)  # the capsule's ends are round


def test_a_planar_base_without_wheels_needs_the_name_of_its_drive(tmp_path):
    with pytest.raises(InputError, match="planar.xml: none of its hinges looks like a wheel .* --drive omni"):
        base_of(robot_files.planar_base(tmp_path))
    limits = {"drive": "omnidirectional", "max_speed": 1.0, "max_acceleration": 2.0, "max_turn_rate": 1.5}
    base = base_of(robot_files.planar_base(tmp_path, robot_files.ARM), **limits)
    model = loaded(base, tmp_path)
    assert float(model.radius) == pytest.approx(np.hypot(0.3, 0.2), rel=1e-4)
    assert float(model.max_turn_acceleration) == pytest.approx(2.0 / float(model.radius), rel=1e-4)
    assert "links that move reach 0.5 m" in base.notes[0]
    origins = {mount.name: np.asarray(mount.origin) for mount in model.mounts}
    np.testing.assert_allclose(origins["lidar"], [0.0, 0.0, 0.2], atol=1e-5)  # on the base and not on the arm
    np.testing.assert_allclose(origins["depth"], [0.0, 0.0, 0.7], atol=1e-5)  # the camera that looks ahead


def stl(path: Path, corners: np.ndarray, ascii_text: bool = False):
    triangles = corners[: len(corners) // 3 * 3].reshape(-1, 3, 3)
    if ascii_text:
        rows = "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangles.reshape(-1, 3))
        path.write_text(f"solid s\n{rows}endsolid s\n")
        return
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + body)


def test_huge_limits_are_none(tmp_path):
    limit = '<limit lower="-1e9" upper="1e9" velocity="inf" effort="0"/>'
    body = urdf_reading.read_urdf(write_urdf(tmp_path, PAIR.replace(LIMIT, limit)))
    assert all((each.max_rate, each.max_torque, each.max_angle) == (None, None, None) for each in body.links)
    with pytest.raises(InputError, match="<limit> needs a number, but velocity is"):
        urdf_reading.read_urdf(write_urdf(tmp_path, PAIR.replace(LIMIT, '<limit velocity="fast"/>')))


def test_meshes_become_the_smallest_shape_around_them(tmp_path):
    numbers = np.random.default_rng(0)
    angle, ball = 2 * np.pi * np.arange(240) / 240, numbers.normal(size=(3000, 3))
    disc = np.stack([0.1 * np.cos(angle), 0.02 * np.sign(np.sin(7 * angle) + 0.1), 0.1 * np.sin(angle)], -1)
    corners = numbers.choice([-1.0, 1.0], (300, 3)) * [0.3, 0.2, 0.1]
    ball = 0.2 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    for points, kind, size in (
        (disc, "cylinder", [0.1, 0.02]),
        (corners, "box", [0.3, 0.2, 0.1]),
        (ball, "sphere", [0.2]),
    ):
        for number, ascii_text in enumerate((False, True)):
            file = tmp_path / f"{kind}{number}.stl"
            stl(file, points + [1.0, 2.0, 3.0], ascii_text)
            turn = rotation(np.array([0.0, 0.0, 1.0]), 0.4)
            shape = foreign_links.enclosing(vertices(file), np.array([0.0, 0.0, 1.0]), turn)
            assert shape.kind == kind
            np.testing.assert_allclose(shape.size, size, rtol=0.03)
            np.testing.assert_allclose(shape.place, turn @ [1, 2, 3] + [0, 0, 1], atol=0.02)


def test_obj_and_collada(tmp_path):
    (tmp_path / "a.obj").write_text("# box\nv 0 0 0\nv 1 2 3\nvn 9 9 9\nf 1 2 1\n")
    np.testing.assert_allclose(vertices(tmp_path / "a.obj"), [[0, 0, 0], [1, 2, 3]])
    (tmp_path / "a.dae").write_text(
        """<COLLADA xmlns="x"><asset><unit meter="0.01"/></asset><library_geometries><geometry id="g"><mesh>
        <source id="p"><float_array id="f" count="6">0 0 0 100 0 0</float_array></source>
        <vertices id="v"><input semantic="POSITION" source="#p"/></vertices></mesh></geometry></library_geometries>
        <library_visual_scenes><visual_scene id="s"><node><translate>0 0 50</translate><rotate>0 0 1 90</rotate>
        <node><instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes></COLLADA>"""
    )
    np.testing.assert_allclose(vertices(tmp_path / "a.dae"), [[0, 0, 0.5], [0, 1, 0.5]], atol=1e-12)


@pytest.mark.parametrize(
    "name, content",
    [("a.obj", "v 0 0 >\n"), ("a.obj", "v 0 0\nv 0 0 0\n"), ("a.stl", "vertex 0 x 0"), ("a.obj", "v 0 0 1e300\n")],
)
def test_numbers_of_a_mesh_that_are_none_are_refused_in_own_words(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as told:
        vertices(tmp_path / name)
    check_error(told.value, name)


def test_xml_is_bounded_in_depth_and_in_number(tmp_path):
    file = tmp_path / "deep.xml"
    for text, fits in (
        ("<a>" * MAX_DEPTH + "</a>" * MAX_DEPTH, True),
        ("<a>" * (MAX_DEPTH + 1) + "</a>" * (MAX_DEPTH + 1), False),
        ("<a>" + "<b/>" * (MAX_ELEMENTS - 1) + "</a>", True),
        ("<a>" + "<b/>" * MAX_ELEMENTS + "</a>", False),
    ):
        file.write_text(text)
        if fits:
            assert xml_tree(file).tag == "a"
        else:
            with pytest.raises(InputError, match="deep.xml:1: elements are too many or nested too deep"):
                xml_tree(file)


def test_meshes_of_packages_are_found_and_missing_ones_named(tmp_path):
    package = tmp_path / "bot_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    angle = 2 * np.pi * np.arange(240) / 240
    disc = np.stack([0.1 * np.cos(angle), 0.02 * np.sign(np.sin(7 * angle) + 0.1), 0.1 * np.sin(angle)], -1)
    stl(package / "meshes" / "wheel.stl", disc * 1000.0)
    mesh = '<mesh filename="package://bot_description/meshes/{}" scale="0.001 0.001 0.001"/>'
    wheels = [
        link(side, 0.5, mesh.format("wheel.stl")) + joint(f"{side}_joint", side, f"0 {y} 0")
        for side, y in (("left", 0.2), ("right", -0.2))
    ]
    base = base_of(write_urdf(package / "urdf", BASE + "".join(wheels) + link("hat", 0.1, mesh.format("hat.dae"))
                         + joint("top", "hat", "0 0 0.3", kind="fixed", limit="")))  # fmt: skip
    assert base.wheel_radius == pytest.approx(0.1, rel=1e-3)
    assert "package://bot_description/meshes/hat.dae" in base.notes[-1]


def test_tilted_boxes_stand_upright():
    turn = rotation(np.array([1.0, 2.0, 0.5]), 1.0)
    shape = foreign_links.LinkShape("box", np.array([0.3, 0.2, 0.1]), np.array([1.0, 2.0, 3.0]), turn)
    made = importing.upright(shape)
    corners = (importing.outline(shape) - made.place) @ made.turn
    np.testing.assert_allclose(np.abs(corners).max(0), made.size, atol=1e-12)
    np.testing.assert_allclose(made.turn[:, 2], [0, 0, 1])
    lying = foreign_links.LinkShape(
        "box", np.array([0.3, 0.2, 0.1]), np.zeros(3), rotation(np.array([0, 1.0, 0]), np.pi / 2)
    )
    assert np.prod(importing.upright(lying).size) == pytest.approx(0.3 * 0.2 * 0.1)


BARE = PAIR.replace(LIMIT, "")


@pytest.mark.parametrize(
    ("parts", "settings", "message"),
    [
        (BARE, {}, "it does not say all that a robot needs; give --max-acceleration and --max-speed."),
        (BARE, {"max_speed": 1.0}, "give --max-acceleration."),
        (link("base_link", 0.0) + wheel("a", "0 0.2 0").replace('value="0.5"', 'value="0"')
         + wheel("b", "0 -0.2 0").replace('value="0.5"', 'value="0"'), {}, "--mass"),
        (BASE + wheel("left_wheel", "0 0.2 0", "") + wheel("right_wheel", "0 -0.2 0", ""), {}, "give --wheel-radius"),
        (BASE, {}, "none of its hinges looks like a wheel on the floor; name the hinges of the left and the right"),
        (PAIR, {"wheels": ("left_joint", "rigth_joint")}, "has no hinge 'rigth_joint'; did you mean 'right_joint'?"),
        (BASE + wheel("a", "0 0.2 0") + wheel("b", "0.3 0.2 0"), {}, "all wheels (a_joint and b_joint) are on one"),
        (PAIR.replace('type="continuous"', 'type="round"', 1), {}, '<joint name="left_joint"> has the type \'round\''),
        (PAIR.replace('parent link="base_link"', 'parent link="bse"', 1), {}, "has the parent 'bse', which is no link"),
        (PAIR.replace('xyz="0 0.2 0"', 'xyz="0 0.2"', 1), {}, "<origin> needs 3 numbers from -1e6 to 1e6, but xyz is"),
        (PAIR.replace('value="8.0"', 'value="-8"', 1), {}, "<mass> is -8 kg; give 0 or more"),
        (PAIR.replace('radius="0.08"', 'radius="0"', 1), {}, "<cylinder> has a size that is 0 or negative"),
        (PAIR + link("left"), {}, '<link name="left"> has the name of the one in line'),
        (PAIR + link("alone"), {}, "has 2 links without a parent ('base_link', 'alone')"),
        (PAIR + joint("loop", "base_link", "0 0 0", "left"), {}, "has a loop of joints"),
        (PAIR.replace("<box", "<cone"), {}, "<cone> is no shape; shapes are box, cylinder, sphere and mesh"),
        (PAIR.replace('"left"', '"${side}"'), {}, "is xacro; expand it to URDF"),
        (PAIR + '<xacro:include filename="arm.xacro"/>', {}, "is xacro; expand it to URDF"),
        (PAIR + "<link", {}, "is not XML"),
        ("", {}, '<robot name="bot"> has no <link>'),
    ],
)  # fmt: skip
def test_a_file_that_is_no_robot_is_refused_in_one_sentence(parts, settings, message, tmp_path):
    with pytest.raises(InputError) as error:
        base_of(write_urdf(tmp_path, parts), **settings)
    assert message in str(error.value) and len(str(error.value).splitlines()) == 1
    assert "bot.urdf" in str(error.value)


def test_mjcf_without_a_freejoint_is_refused(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(robot_files.FIXED_BODY)
    with pytest.raises(InputError, match="no body has a <freejoint>, or slide joints and a hinge about z"):
        base_of(path)
    path.write_text(robot_files.TWO_FREE_BODIES)
    with pytest.raises(InputError, match="2 bodies have a <freejoint>: 'a', 'b'"):
        base_of(path)


def test_files_of_this_package_are_read_again(tmp_path):
    """Kuri as a foreign robot: the same mass, wheels, track and radius."""
    kuri = robots.load("kuri", "twin")
    again = loaded(base_of(robots.ROBOTS["kuri"], max_speed=0.5, max_acceleration=5.0), tmp_path)
    for name in ("mass", "wheel_radius", "track"):
        assert float(getattr(again, name)) == pytest.approx(float(getattr(kuri, name)), rel=1e-3)
    assert float(again.radius) == pytest.approx(0.15, rel=0.02)


def test_the_command_writes_a_robot_that_drives(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_urdf(tmp_path, PAIR + CASTER + LASER)
    assert command_line.main(["import-robot", "bot.urdf", "--out", "made.xml", "--max-turn-rate", "2"]) == 0
    text = capsys.readouterr().out
    gap, lag = map(float, re.findall(r"(\S+) mm from", text))
    assert gap <= 0.01 and 0.0 < lag < 100.0
    assert "differential (wheels left_joint and right_joint)" in text and "next: sean run --robot made.xml" in text
    assert (tmp_path / "made.png").stat().st_size > 10_000
    assert float(robots.load(tmp_path / "made.xml").max_turn_rate) == 2.0
    before = (tmp_path / "made.xml").read_text()
    assert command_line.main(["import-robot", "bot.urdf", "--out", "made.xml", "--wheels", "none,right_joint"]) == 2
    assert "--wheels: bot.urdf has no hinge 'none'" in capsys.readouterr().err
    assert (tmp_path / "made.xml").read_text() == before


@pytest.mark.night
@pytest.mark.parametrize("parts", [PAIR, PAIR + STEERED, BASE + SWIVELS], ids=["pair", "car", "swerve"])
def test_imported_robots_drive_in_mjx_as_in_closed_form(parts, tmp_path):
    result = import_robot(write_urdf(tmp_path, parts), tmp_path / "made.xml")
    assert result.gap <= 1e-5 and 0.0 < result.lag < 0.1
    words = f"run --robot {tmp_path / 'made.xml'} --people 3 --episodes 1 --time-limit 5 --out {tmp_path / 'r'} --quiet"
    assert command_line.main(words.split()) == 0


def test_urdf_is_a_tree_at_rest(tmp_path):
    """The pose of a link below turned joints, by matrices of hand."""
    parts = BASE + link("a", 1.0, "") + joint("ja", "a", "1 0 0", kind="fixed", limit="", turn="0.1 0.2 0.3")
    parts += link("b", 1.0, "", pose="0 0 1") + joint("jb", "b", "0 2 0", "a", "fixed", limit="", turn="0 0.5 0")
    body = urdf_reading.read_urdf(write_urdf(tmp_path, parts))
    x, y, z = np.eye(3)
    first = rotation(z, 0.3) @ rotation(y, 0.2) @ rotation(x, 0.1)
    at = {each.name: each for each in body.links}
    np.testing.assert_allclose(at["b"].place, [1, 0, 0] + first @ [0, 2, 0], atol=1e-12)
    np.testing.assert_allclose(at["b"].center, at["b"].place + first @ rotation(y, 0.5) @ [0, 0, 1], atol=1e-12)


def test_the_robot_of_the_documentation(tmp_path):
    shutil.copy(ROOT / "examples" / "courier.urdf", tmp_path)
    base = base_of(tmp_path / "courier.urdf")
    assert base.drive == "differential" and not base.body.missing and base.max_speed == pytest.approx(0.99)
    (lidar,) = [mount for mount in loaded(base, tmp_path).mounts if mount.name == "lidar"]
    np.testing.assert_allclose(lidar.origin, [0.15, 0.0, 0.27], atol=1e-6)


def test_changed_numbers_make_a_robot_or_a_sentence(tmp_path):
    """One number of a file is replaced by a wrong one: the file is refused in one line, or the robot loads."""
    draw, loads = random.Random(0), 0
    texts = [write_urdf(tmp_path, parts).read_text() for parts in (PAIR + CASTER + LASER, PAIR + STEERED, BASE + THREE)]
    path = tmp_path / "changed.urdf"
    for _ in range(60):
        text = draw.choice(texts)
        place = draw.choice(list(re.finditer(r"-?\d+\.?\d*", text)))
        wrong = draw.choice(["0", "-1", "1e9", "1e-9", "nan", "inf", "x", "1e300", "", "-0.5"])
        path.write_text(text[: place.start()] + wrong + text[place.end() :])
        try:
            loaded(base_of(path, max_speed=1.0, max_acceleration=1.0, max_turn_rate=2.0), tmp_path)
            loads += 1
        except InputError as error:
            assert len(str(error).splitlines()) == 1
    assert 10 < loads < 55
