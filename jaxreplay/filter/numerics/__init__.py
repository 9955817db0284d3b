"""What makes the equations exact and fast; a reader of the paper need not open it.

- `scaled`: numbers with an exponent of their own, so that no probability underflows.
- `gaussian`: means of a Gaussian along segments, relative to an anchor, accurate also 1,000 σ away
  from all records.
- `anchor`: the point that densities are relative to.
- `compensated`: sums and products with their rounding errors.
- `polynomial`: smooth functions as polynomials.
- `stage`, `blocks`: how a step is cut into pieces that XLA compiles well.
"""
