"""A simulated robot that fetches a cube on a plane (§ 3), as Gymnasium environments.

Everything here takes and returns arrays; nothing here imports records, filters or studies. `env`
has B worlds that advance together, `single` has one world; both are built from `world` (physics),
`actuators` and `sensors`, with the constants of `params`.
"""

import gymnasium

gymnasium.register(
    "jaxreplay/FetchCube-v0",
    entry_point="jaxreplay.plane.single:PlaneEnv",
    vector_entry_point="jaxreplay.plane.env:PlaneVectorEnv",
)
