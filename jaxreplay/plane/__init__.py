"""A robot, a cube and an experimental area on a plane; knows nothing of the filter."""

import gymnasium

gymnasium.register(
    "jaxreplay/FetchCube-v0",
    entry_point="jaxreplay.plane.single:PlaneEnv",
    vector_entry_point="jaxreplay.plane.env:PlaneVectorEnv",
)
