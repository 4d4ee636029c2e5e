"""Memory that was freed goes back to the system."""

import subprocess
import sys

CODE = """
from pathlib import Path
from nailoptics.memory import give_back

def resident_kb():
    return next(int(line.split()[1]) for line in Path("/proc/self/status").open() if line.startswith("VmRSS"))

blocks = [bytearray(100_000) for _ in range(1000)]
del blocks[:-1]
before = resident_kb()
give_back()
print(before - resident_kb())
"""


def test_what_is_freed_below_what_is_kept_goes_back_to_the_system():
    """Of 100 MB in a heap whose last block stays; the system's library alone keeps all of them."""
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 80_000
