"""Makes the loop's modules and the controller importable."""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
LOOP = os.path.dirname(HERE)
EXAMPLE = os.path.join(os.path.dirname(os.path.dirname(LOOP)), "examples", "swing_control")
sys.path[:0] = [LOOP, EXAMPLE]
RIG = os.path.join(LOOP, "rig.yaml")
