import numpy as np
import pytest
from plane_helpers import EXACT

from jaxreplay.plane import stepping
from jaxreplay.plane.world import World


@pytest.mark.skipif(stepping.advance is stepping.advance_public, reason="pymunk has no such calls")
def test_private_and_public_calls_move_a_world_alike_bit_for_bit():
    rng = np.random.default_rng(0)
    worlds = [World(EXACT, np.array([0.2, 0.02, 0.1])) for _ in range(2)]
    ways = stepping.advance_private, stepping.advance_public
    for k in range(200):
        forward, turn = rng.uniform([-0.02, -0.5], [0.1, 0.5])
        if k == 60:
            for world in worlds:
                world.hold(0.5, 0.005)
        a, b = (way(world, forward, turn) for way, world in zip(ways, worlds, strict=True))
        assert a == b
    assert a[3:] != (0.2, 0.02, 0.1)
