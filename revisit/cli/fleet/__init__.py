"""The simulated fleet through a service: its drives are streamed, wrong loops put in, the map optimised and measured.

recording    six drives streamed into a service, once
spoiling     wrong loops put into a copy of what it stored
run          each copy optimised by a service of its own, and compared with the truth
"""

from revisit.cli.fleet.run import SPOILINGS, run_fleet

__all__ = ["SPOILINGS", "run_fleet"]
