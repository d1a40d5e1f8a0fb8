"""Robots as URDF and MJCF: whole files, parts to put together, and files that the readers refuse."""

import re
from collections.abc import Sequence
from pathlib import Path

# URDF, put together from links and joints

LIMIT = '<limit effort="3" velocity="10" lower="-0.6" upper="0.6"/>'


def link(
    name: str, mass: float = 1.0, shape: str = '<box size="0.4 0.3 0.1"/>', pose: str = "0 0 0", turn: str = "0 0 0",
    inertia: float = 0.01,
) -> str:  # fmt: skip
    """A link (kg, kg m^2); one without a mass or a shape says nothing of it."""
    about = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
    geometry = (
        f'<collision><origin xyz="{pose}" rpy="{turn}"/><geometry>{shape}</geometry></collision>' if shape else ""
    )
    inertial = f'<inertial><origin xyz="{pose}"/><mass value="{mass}"/>{about}</inertial>' if mass else ""
    return f'<link name="{name}">{inertial}{geometry}</link>'


def joint(
    name: str, child: str, pose: str, parent: str = "base_link", kind: str = "continuous", axis: str = "0 1 0",
    limit: str = LIMIT, turn: str = "0 0 0",
) -> str:  # fmt: skip
    """A joint between two links."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{pose}" rpy="{turn}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def wheel(name: str, pose: str, shape: str = '<cylinder radius="0.08" length="0.04"/>', **more: str) -> str:
    """A link and the joint that it turns about."""
    body = link(name, 0.5, shape, turn="1.570796327 0 0")
    return body + joint(f"{name}_joint", name, pose, **more)


def urdf(parts: str) -> str:
    """A robot of these links and joints, a line each."""
    lines = parts.replace("><link", ">\n<link")
    return f'<?xml version="1.0"?>\n<robot name="bot">\n{lines}\n</robot>\n'


def write_urdf(folder: Path, parts: str) -> Path:
    """Write ``bot.urdf`` with these links and joints."""
    path = folder / "bot.urdf"
    path.write_text(urdf(parts))
    return path


BASE = link("base_link", 8.0, pose="0.02 0 0.05")
PAIR = BASE + wheel("left", "0 0.2 0") + wheel("right", "0 -0.2 0")
CASTER = link("caster", 0.2, "") + joint("caster_swivel", "caster", "-0.15 0 -0.02", axis="0 0 1")
CASTER += wheel("caster_wheel", "0 0 -0.03", '<cylinder radius="0.03" length="0.02"/>', parent="caster")
LASER = link("laser", 0.1, '<cylinder radius="0.03" length="0.05"/>')
LASER += joint("laser_mount", "laser", "0.1 0 0.2", kind="fixed", limit="", turn="0 0 0.5")
CART = urdf(PAIR + CASTER + LASER)


# MJCF that sean import-robot reads

FREE_CART = """<mujoco model="free"><compiler autolimits="true"/><worldbody><geom type="plane" size="1 1 1"/>
  <body name="base" pos="3 1 0.1" euler="0 0 40"><freejoint/>
    <geom type="box" size="0.2 0.15 0.05" mass="5"/>
    <geom type="sphere" size="0.9" mass="0" contype="0" conaffinity="0"/>
    <site name="front_laser" pos="0.1 0 0.2"/> <camera name="eye" pos="0.2 0 0.3" xyaxes="0 -1 0 0 0 1"/>
    <body name="lw" pos="0 0.2 0"><joint name="l" axis="0 1 0"/>
      <geom type="cylinder" size="0.1 0.02" euler="90 0 0" mass="0.5"/></body>
    <body name="rw" pos="0 -0.2 0"><joint name="r" axis="0 1 0"/>
      <geom type="cylinder" size="0.1 0.02" euler="90 0 0" mass="0.5"/></body>
    <body name="arm" pos="0 0 0.2"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" size="0.03 0.2" mass="0.4"/></body>
  </body></worldbody>
  <actuator><velocity joint="l" kv="3" ctrlrange="-8 8" forcerange="-2 2"/>
  <velocity joint="r" kv="3" ctrlrange="-8 8" forcerange="-2 2"/></actuator></mujoco>"""
ARM = """<body name="arm" pos="0 0 0.4"><joint name="shoulder" axis="0 0 1"/>
    <geom type="box" size="0.5 0.02 0.1" mass="1"/><camera name="hand" pos="0.5 0 0" xyaxes="-1 0 0 0 0 1"/>
    <camera name="top" xyaxes="0 -1 0 1 0 0"/><camera name="head" pos="0 0 0.3" xyaxes="0 -1 0 0 0 1"/></body>"""


def planar_base(folder: Path, parts: str = "") -> Path:
    """Write ``planar.xml``: a box that slides and turns, with these bodies on it."""
    path = folder / "planar.xml"
    path.write_text(
        f"""<mujoco><worldbody><body name="base"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
        <joint axis="0 0 1"/><geom type="box" size="0.3 0.2 0.1" pos="0 0 0.1" mass="9"/>{parts}
        </body></worldbody></mujoco>"""
    )
    return path


FIXED_BODY = '<mujoco><worldbody><body name="a"><geom size="1"/></body></worldbody></mujoco>'
_FREE = '<body name="{}" pos="{} 0 0"><freejoint/><geom size="1"/></body>'
TWO_FREE_BODIES = f"<mujoco><worldbody>{_FREE.format('a', 0)}{_FREE.format('b', 3)}</worldbody></mujoco>"

# MJCF of a robot of the package's kind

PUCK = """\
<!-- Puck: a small round robot. -->
<mujoco model="puck">
  <option timestep="0.02" integrator="Euler"/>
  <custom>
    <numeric name="max_speed" data="0.3"/> <numeric name="max_turn_rate" data="2.0"/>
    <numeric name="max_acceleration" data="1.0"/> <numeric name="max_turn_acceleration" data="5.0"/>
    <numeric name="command_timeout" data="0.25"/> <numeric name="radius" data="0.1"/>
    <numeric name="friction" data="0.8"/>
  </custom>
  <default>
    <geom contype="0" conaffinity="0"/>
    <joint armature="0.001"/>
    <velocity kv="0.04" forcerange="-0.2 0.2"/>
  </default>
  <worldbody>
    <body name="base">
      <joint name="x" type="slide" axis="1 0 0" armature="0"/> <joint name="y" type="slide" axis="0 1 0" armature="0"/>
      <joint name="yaw" type="hinge" axis="0 0 1" armature="0"/>
      <geom type="cylinder" size="0.1 0.04" pos="0 0 0.06" mass="1.5"/>
      <body name="left" pos="0 0.08 0.03"> <joint name="left" type="hinge" axis="0 1 0"/>
        <geom type="cylinder" size="0.03 0.01" zaxis="0 1 0" mass="0.05"/> </body>
      <body name="right" pos="0 -0.08 0.03"> <joint name="right" type="hinge" axis="0 1 0"/>
        <geom type="cylinder" size="0.03 0.01" zaxis="0 1 0" mass="0.05"/> </body>
    </body>
  </worldbody>
  <actuator> <velocity joint="left"/> <velocity joint="right"/> </actuator>
</mujoco>
"""

# MJCF of articulated bodies

GROUND = '<geom type="plane" size="0 0 0.01"/>'
_CASTER = '<geom type="sphere" size="0.05" pos="-0.18 0 -0.05" mass="0.2" friction="0.001" condim="1"/>'
# Two wheels, a caster and an arm.
ROVER = f"""
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    {GROUND}
    <body name="base" pos="0 0 0.1">
      <freejoint/>
      <geom type="box" size="0.2 0.12 0.04" mass="6" contype="0" conaffinity="0"/>
      {_CASTER}
      <site name="lidar" pos="0 0 0.2"/>
      <body pos="0.08 0.16 0"><joint name="left" axis="0 1 0" damping="0.01"/>
        <geom type="sphere" size="0.1" mass="0.5"/></body>
      <body pos="0.08 -0.16 0"><joint name="right" axis="0 1 0" damping="0.01"/>
        <geom type="sphere" size="0.1" mass="0.5"/></body>
      <body pos="0.1 0 0.06"><joint name="arm" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size="0.015" fromto="0 0 0 0 0 0.25" mass="0.3" contype="0" conaffinity="0"/></body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="left" kv="2" forcerange="-4 4"/>
    <velocity joint="right" kv="2" forcerange="-4 4"/>
    <position joint="arm" kp="3" kv="0.3"/>
  </actuator>
  <keyframe><key name="home" qpos="0 0 0.1 1 0 0 0 0 0 0.5"/></keyframe>
</mujoco>
"""
ROVER_IN_THE_AIR = ROVER.replace(GROUND, "")
ROVER_WITH_CASTER_UP = ROVER.replace(_CASTER, _CASTER.replace("-0.18 0 -0.05", "-0.18 0 0.2"))  # it falls on its back
_LOOK = '<inertial pos="0 0 0" mass="6" diaginertia="0.1 0.1 0.1"/><geom type="mesh" mesh="look" {}/>'
_WITH_MESH = ROVER.replace("<worldbody>", '<asset><mesh name="look" file="none.stl"/></asset><worldbody>')
# A base that looks like a mesh whose file is missing; the second one's mesh touches others.
ROVER_OF_A_MESH, ROVER_OF_A_TOUCHING_MESH = (
    _WITH_MESH.replace("<freejoint/>", "<freejoint/>" + _LOOK.format(contacts))
    for contacts in ('contype="0" conaffinity="0"', "")
)
_END, _BEGIN = "</worldbody>", "<worldbody>"
_FAULTS = [
    ("<freejoint/>", "<joint axis='0 0 1'/>", "must have one freejoint, its first joint; give its base one"),
    (_END, f"<body><geom size='0.1'/></body>{_END}", "all bodies must hang on the one"),
    ('timestep="0.005"', 'integrator="RK4"', "must be Euler or implicitfast"),
    ('type="plane"', 'type="plane" pos="0 0 0.1"', "one horizontal plane at height 0"),
    (_END, f"<geom size='0.1'/>{_END}", "one horizontal plane at height 0"),
    (_BEGIN, f"<default><geom contype='2' conaffinity='4'/></default>{_BEGIN}", "touches the ground"),
]
# Rovers that are refused, and what is said of them.
_SHORT = re.sub("<keyframe>.*</keyframe>", "", ROVER)
REFUSED_ROVERS = [(_SHORT.replace(old, new), words) for old, new, words in _FAULTS]


def _leg(name: str, place: Sequence[float]) -> str:
    """A hip about the vertical that swings the foot ahead, and a knee about x that lifts it."""
    x, y = place
    side = 1 if y > 0 else -1
    return f"""
      <body pos="{x} {y} 0"><joint name="{name}_hip" axis="0 0 1" damping="0.4" armature="0.01"/>
        <geom type="capsule" size="0.015" fromto="0 0 0 0 {0.08 * side} 0" mass="0.08" contype="0" conaffinity="0"/>
        <body pos="0 {0.08 * side} 0"><joint name="{name}_knee" axis="{side} 0 0" damping="0.4" armature="0.01"/>
          <geom type="capsule" size="0.012" fromto="0 0 0 0 0 -0.1" mass="0.05" contype="0" conaffinity="0"/>
          <geom type="sphere" size="0.02" pos="0 0 -0.1" mass="0.03"/>
        </body></body>"""


LEGS = {"fl": (0.12, 0.08), "fr": (0.12, -0.08), "rl": (-0.12, 0.08), "rr": (-0.12, -0.08)}
CRAWLER = f"""
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="trunk" pos="0 0 0.12">
      <freejoint/>
      <geom type="box" size="0.15 0.08 0.03" mass="1.5" contype="0" conaffinity="0"/>
      {"".join(_leg(name, place) for name, place in LEGS.items())}
    </body>
  </worldbody>
  <actuator>
    {"".join(f'<position joint="{n}_{j}" kp="10"/>' for n in LEGS for j in ("hip", "knee"))}
  </actuator>
</mujoco>
"""
CRAWLER_ON_THE_GROUND = CRAWLER.replace("<worldbody>", f"<worldbody>{GROUND}")
