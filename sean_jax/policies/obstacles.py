"""Distances from places to the obstacles near them, in the frame of the floor."""

from jaxtyping import Float

from sean_jax.core.data_types import Array, Environment
from sean_jax.core.geometry import from_rectangle, nearby_obstacles


def obstacle_distances(
    environment: Environment, x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape W"], Float[Array, "*shape W"], Float[Array, "*shape W"]]:
    """Distances [m] of places (x, y) [m] from W obstacles near them, negative inside; and x, y of the normals.

    The normals point away from the obstacles.
    """
    boxes = nearby_obstacles(environment.obstacle_grid, x, y)  # (*shape, W, 6)
    if x.ndim:
        x, y = x[..., None], y[..., None]
    return from_rectangle(x, y, *(boxes[..., column] for column in range(6)))
