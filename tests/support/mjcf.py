"""MJCF texts of scenes: boxes on a floor, and scenes that the readers refuse or must not change."""

from collections.abc import Sequence

EMPTY = "<mujoco></mujoco>"
PLANE = '<geom name="floor" type="plane" size="5 5 0.1"/>'


def box(
    center: Sequence[float], half_extent: Sequence[float], height: float = 2.0, turn: float = 0.0, name: str = ""
) -> str:
    """A box that stands on the floor (m), turned by so many degrees."""
    (x, y), (a, b), half = center, half_extent, height / 2
    named = f' name="{name}"' if name else ""
    return f'<geom{named} type="box" pos="{x} {y} {half}" size="{a} {b} {half}" euler="0 0 {turn}"/>'


def scene(*geoms: str, assets: str = "") -> str:
    """A scene of these geoms; ``assets`` are materials and textures."""
    return f"<mujoco>{f'<asset>{assets}</asset>' if assets else ''}<worldbody>{''.join(geoms)}</worldbody></mujoco>"


def with_geom(text: str, geom: str) -> str:
    """The scene of a text, with one more geom at its end."""
    return text.replace("</worldbody>", f"{geom}</worldbody>")


def with_includes(text: str, *files: str) -> str:
    """The scene or robot of a text, which includes these files as well."""
    return text.replace("</mujoco>", "".join(f'<include file="{file}"/>' for file in files) + "</mujoco>")


# A hall with something of everything: names, degrees, a texture, copies.
HALL = """<mujoco model="hall">
  <compiler angle="degree"/>
  <size memory="1M"/>
  <asset>
    <texture name="t" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0 0 0" width="64" height="64"/>
  </asset>
  <worldbody>
    <light pos="0 0 5" dir="0 0.1 -1"/>
    <geom name="floor" type="plane" size="5 4 0.1"/>
    <geom name="wall_0" type="box" size="5 0.1 1" pos="0 4 1" euler="0 0 0"/>
    <geom name="wall_1" type="box" size="1 1 1" pos="1 0 1" euler="0 0 0"/>
    <replicate count="2" offset="0.5 0 0"><geom type="box" size="0.1 0.1 1" pos="-3 -2 1"/></replicate>
  </worldbody>
</mujoco>
"""

# Attributes and comments as somebody may write them by hand.
HANDWRITTEN = """\
<mujoco model="m"><compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="6 4 0.1"/>
    <!-- ü: a letter of two bytes; <geom name="no"/> -->
    <geom name='quoted'
          type="box" size = "1 0.5 0.4" pos="0 0 0.4" quat="1 0 0 0" /> <geom name="beside" type="box" size="1 1 1"
      pos="3 0 1"></geom>
    <body pos="1 1 0"><geom name="inner" type="box" size="1 1 1" pos="0 0 1"/></body>
    <geom type="box" size="1 1 1" pos="-3 0 1"/>
    <geom name="lamp" type="box" pos="0 0 3" size="1 1 1" contype="0" conaffinity="0"/>
  </worldbody>
</mujoco>
"""
BESIDE = '<geom name="beside" type="box" size="1 1 1"\n      pos="3 0 1"></geom>'  # of HANDWRITTEN

# A box in a turned body, and a sphere that nothing collides with.
BOX_IN_A_BODY = '<body pos="-2 0 0" euler="0 0 90"><geom type="box" pos="1 0 1" size="0.5 0.2 1"/></body>'
DECORATION = '<geom type="sphere" size="1" contype="0" conaffinity="0"/>'

_BOX = '<geom name="box" type="box" pos="1 0 0.5" size="0.5 0.5 0.5"/>'
# Geoms that no environment may have, and what is said of them.
REFUSED_GEOMS = [
    (_BOX.replace("/>", ' euler="10 0 0"/>'), "geom 'box' is tilted; turn it about the vertical axis only"),
    (_BOX + '<geom name="ball" type="sphere" size="1"/>', "geom 'ball' is a sphere; replace it by one or more"),
    (_BOX + '<geom type="cylinder" size="1 1"/>', "the unnamed geom number 3 is a cylinder"),
    (_BOX.replace("0 0.5", "0 2.5", 1), "geom 'box' begins 2.00 m above the floor; extend it down to z = 0"),
    (_BOX.replace("0 0.5", "0 -0.6", 1), "geom 'box' lies below the floor"),
    (f"<body><freejoint/>{_BOX}</body>", "geom 'box' is on a body with a joint"),
    (_BOX + '<geom name="wall" type="plane" size="1 1 1" euler="90 0 0"/>', "geom 'wall' is a tilted plane"),
    ("<geom/>", "MuJoCo cannot read it: size 0 must be positive in geom (line 1, element '')"),
]

_TEXTURE = '<texture name="t" type="2d" builtin="flat" width="60000" height="60000"/>'
_SKY = '<texture type="skybox" builtin="gradient" width="60000"/>'
_PILLAR = '<geom type="box" size="1 1 1" pos="0 0 1"/>'
# What MuJoCo must not compile, and what is said of it in line 3 of ``lines_of(text)``.
UNSAFE = [
    (_PILLAR.replace("0 0 1", "nan 0 1"), 'pos="nan 0 1" holds a number that is not finite'),
    (_PILLAR.replace("1 1 1", "inf 1 1"), 'size="inf 1 1" holds a number that is not finite'),
    (_PILLAR.replace("1 1 1", "1e39 1 1"), "holds a number beyond 1e+10"),
    (f'<replicate count="100000">{_PILLAR}</replicate>', 'count="100000" must be at most 1,000'),
    (f'<replicate count="999"><replicate count="999">{_PILLAR}</replicate></replicate>', "more than 10,000 elements"),
    ('<composite type="grid" count="9999 9999 1"/>', "<composite> has no place in a scene or a robot"),
    ("<body>" * 100 + "</body>" * 100, "nested deeper than 60 levels"),
    ('</worldbody><size memory="900G"/><worldbody>', 'size memory="900G" must be at most 100M'),
    ('</worldbody><size nuser_geom="1000000000"/><worldbody>', "must be at most 10,000"),
    (f"</worldbody><asset>{_TEXTURE}</asset><worldbody>", "more than 25 million pixels"),
    (f"</worldbody><asset>{_SKY}</asset><worldbody>", "more than 25 million pixels"),
    (f"</worldbody><asset>{_SKY.replace('skybox', 'cube')}</asset><worldbody>", "more than 25 million pixels"),
    ('</worldbody><include file="scene.xml"/><worldbody>', "scene.xml includes itself"),
    ('</worldbody><include file="pipe"/><worldbody>', "it is a pipe"),
    ("</geom>", "is not XML: mismatched tag"),
]


def lines_of(text: str) -> str:
    """A scene of this text, in line 3."""
    return f"<mujoco>\n<worldbody>\n{text}\n</worldbody>\n</mujoco>\n"


DOCUMENT_TYPE = '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>\n<mujoco model="&b;"/>'


def picture_scene(compiler: str, file: str, compiler_last: bool) -> str:
    """A scene with a texture from a file, one element a line."""
    lines = [compiler, f'<asset><texture name="t" type="2d" file="{file}"/></asset>']
    return "<mujoco>\n" + "\n".join(lines[::-1] if compiler_last else lines) + "\n</mujoco>\n"


def side_scene(kind: str) -> str:
    """A scene with a texture from ``side.png``; ``kind`` are attributes of it."""
    return f'<mujoco><asset><texture name="t" file="side.png" {kind}/></asset></mujoco>'


# A checker of two colors that differ in all channels, the lighter one with less red.
CHECKER = (
    '<mujoco><asset><texture name="t" type="2d" builtin="checker" width="8" height="8" '
    'rgb1="0.2 1 1" rgb2="0.4 0 0"/></asset></mujoco>'
)

_TILES = (
    '<texture name="t" type="2d" builtin="checker" rgb1="0.2 0.2 0.2" rgb2="0.4 0.4 0.4" width="50" height="50" {}/>'
    '<material name="floor" texture="t" texrepeat="4 4" {}/>'
)
_FLOOR = '<geom type="plane" size="5 4 0.1" {}/>'
# Assets and plane of a floor of 10 x 8 m: 4 x 4 textures of 2 x 2 squares with red joints, or one texture each metre.
FLOORS = {
    "tiles with joints": (_TILES.format('mark="edge" markrgb="1 0 0"', ""), _FLOOR.format('material="floor"')),
    "tiles by the metre": (_TILES.format("", 'texuniform="true"'), _FLOOR.format('material="floor"')),
    "one color": ("", _FLOOR.format('rgba="0.1 0.2 0.3 1"')),
    "no color": ("", _FLOOR.format("")),
}
BLUE = '<material name="rack_blue" rgba="0 0 1 1"/>'
BLUE_TABLE = '<geom name="table" type="box" pos="-1 2 0.5" size="0.4 0.2 0.5" material="rack_blue"/>'
