import json
import subprocess
import sys

PROGRAM = """
import gc, json
from hpccomponent.runtime.garbage_collection import rare_collections
with rare_collections():
    held = [[] for _ in range(20_000)]
    print(json.dumps([gc.get_count()[0] > 20_000, gc.get_freeze_count()]))
print(json.dumps([len(gc.get_objects()) < 1000, gc.get_freeze_count() > 20_000]))
"""


def test_a_program_collects_rarely_and_not_at_its_exit() -> None:
    done = subprocess.run([sys.executable, "-P", "-c", PROGRAM], capture_output=True, check=True)
    inside, after = map(json.loads, done.stdout.decode().splitlines())
    assert inside == [True, 0]
    assert after == [True, True]
