"""An EC2 cloud for tests: moto behind a front that is as strict as the clouds that people have.

::

    with StrictCloud("euca-4.0") as cloud:          # aws, euca-4.0 ... euca-5.1, generic
        provider = cloud.provider_block(small={"instance_type": ["c6i.xlarge", "c6a.xlarge"]})
        environment = {**os.environ, **cloud.environment()}      # for processes
        cloud.fail("RunInstances", "InsufficientInstanceCapacity", 500,
                   match={"InstanceType": "c6i.xlarge"}, times=FOREVER)
        cloud.lose("RunInstances")                               # done, but its answer is cut off
        ...
        assert not cloud.left()                                  # machines, groups, key pairs
        changes = [call.action for call in cloud.calls if call.changes]

- `cloud.hook = function(call, moment)` runs before and after each call, outside of all locks; it
  may kill a process, and may raise `CutError`: "before", the request never arrived; "after", its
  answer is lost.
- `cloud.on_launch = function(instance)` may bind an instance to a machine of the test:
  ``instance.place(private, public)``, ``instance.console = "..."``; `cloud.on_terminate` likewise.
  With ``StrictCloud(..., pending=None)`` an instance is pending until ``instance.boot()``;
  otherwise until it has been described so many times. Nothing depends on time.
- ``instance.shut_down()`` is a guest that switches itself off, ``instance.die(reason)`` one that
  the cloud ends: a spot interruption, or one that never boots.
- ``lag=n``: so many times a new instance is not found by its id; ``list_lag=n``: so many lists
  leave it out.
- ``cloud.no_rights = {"RunInstances"}``: UnauthorizedOperation. Signatures are verified:
  other keys are refused.
- ``cloud.model.backend`` is moto's own, for what a test wants to be there beforehand.

What the front adds to moto, and what for: see `front.py`; which parameters a cloud knows:
`parameters.py`.
"""

import base64

from cloud.calls import FOREVER, Call, CutError
from cloud.front import StrictCloud
from cloud.instances import Instance

__all__ = ["FOREVER", "RSA_KEY", "Call", "CutError", "Instance", "StrictCloud"]

RSA_KEY = (
    "ssh-rsa "
    + base64.b64encode(b"\0\0\0\x07ssh-rsa\0\0\0\x03\1\0\1\0\0\1\1\0" + b"\xc5" * 256).decode()
)
"""A public key such as clouds import."""
