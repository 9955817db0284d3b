"""Records Π (§ 2.1): the demonstrations, as arrays that the filter takes."""

from jaxreplay.records.long import CHUNK, LongestFirst
from jaxreplay.records.records import Records

__all__ = ["CHUNK", "LongestFirst", "Records"]
