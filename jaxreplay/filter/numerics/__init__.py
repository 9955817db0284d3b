"""What makes the equations exact and fast; a reader of the paper need not open it.

- `segment`: means of a Gaussian along segments, relative to an anchor.
- `long_segments`: the states whose segments need their exact form, from the records' list.
- `anchor`: the point that densities are relative to.
- `polynomial`: smooth functions as quotients of polynomials.
- `scaled`: numbers with an exponent of their own, so that no probability underflows.
- `stage`, `blocks`: how a step is cut into pieces that XLA compiles well.
"""
