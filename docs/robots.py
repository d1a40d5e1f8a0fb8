"""Draws the picture of docs/robots.md, docs/pictures/robots.png, of all robots with MuJoCo: python docs/robots.py.

Robots at one scale on squares of 0.5 m, the Warthog at less than half of it. It needs a display or ``MUJOCO_GL=egl``.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco

from sean_jax import robots

PICTURE = Path(__file__).resolve().parent / "pictures" / "robots.png"
SIZE = 300  # pixels of a robot's picture


def view(path: Path) -> object:
    """The pixels of a robot on a floor, from ahead on its left."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.add_texture(name="squares", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
                     rgb1=[0.86, 0.88, 0.9], rgb2=[0.78, 0.8, 0.83], width=512, height=512)  # fmt: skip
    floor = spec.add_material(name="squares", texrepeat=[1.0, 1.0], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[8.0, 8.0, 0.1], material="squares", mass=0.0,
                            rgba=[1.0] * 4)  # fmt: skip
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
                     rgb1=[0.95, 0.96, 0.98], width=64, height=64)  # fmt: skip
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.25] * 3
    spec.visual.global_.offwidth = spec.visual.global_.offheight = SIZE
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eye = mujoco.MjvCamera()
    large = "warthog" in path.name
    eye.lookat, eye.distance, eye.azimuth, eye.elevation = [0.0, 0.0, 0.4], 4.6 if large else 2.1, 215.0, -22.0
    with mujoco.Renderer(model, SIZE, SIZE) as renderer:
        renderer.update_scene(data, eye)
        return renderer.render()


figure, axes = plt.subplots(3, 3, figsize=(9, 9.4), layout="constrained")
for axis, (name, path) in zip(axes.flat, robots.ROBOTS.items(), strict=True):
    model = robots.load(name)
    axis.imshow(view(path))
    axis.set_title(f"{name}, {model.drive_type}", fontsize=11)
    axis.axis("off")
figure.savefig(PICTURE, dpi=100, pil_kwargs={"optimize": True})
