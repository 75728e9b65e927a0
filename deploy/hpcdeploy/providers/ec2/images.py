"""The images of a cluster file: by id, by a parameter of the cloud's own, or the newest of a name.

What does not name an id is looked up once for a command, so that all machines of one `up` boot the
same image.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.client import Calls, Described
from hpcdeploy.spec.provider import CloudSpec, Image


class Images:
    """Finds images, each once; safe to use from several threads.

    `read_parameter` returns a value in the cloud's parameter store (SSM), by its name.
    """

    def __init__(self, calls: Calls, read_parameter: Callable[[str], str]) -> None:
        self._calls = calls
        self._read_parameter = read_parameter
        self._images: dict[Image, Described] = {}
        self._lock = threading.Lock()

    def find(self, image: Image) -> Described:
        """Return an image as the cloud describes it.

        Raises CloudError where there is none, or it cannot be used yet.
        """
        with self._lock:
            if image not in self._images:
                self._images[image] = self._look_up(image)
            return self._images[image]

    def decided(self, cloud: CloudSpec) -> tuple[str, ...]:
        """Say which images were found for profiles that name none by its id, in a line each."""
        return tuple(
            f"image of profile {name}: {described['ImageId']} "
            f"({described.get('Name', 'without a name')}), "
            f"{describe_image(profile.image)}"
            for name, profile in cloud.profiles.items()
            if profile.image.id is None
            for described in [self.find(profile.image)]
        )

    def _look_up(self, image: Image) -> Described:
        if image.name is not None:
            return self._newest(image)
        image_id = image.id
        if image.ssm is not None:
            image_id = self._read_parameter(image.ssm)
        reply = self._calls.call("describe_images", f"find image {image_id}", ImageIds=[image_id])
        for described in reply["Images"]:
            if described.get("State", "available") == "available":
                return dict(described)
        raise CloudError(f"image {image_id} is not available", "check the profile's image")

    def _newest(self, image: Image) -> Described:
        what = describe_image(image)
        images = self._calls.call(
            "describe_images",
            f"find an image, {what}",
            Owners=[image.owner],
            Filters=[
                {"Name": "name", "Values": [image.name]},
                {"Name": "state", "Values": ["available"]},
            ],
        )["Images"]
        if not images:
            raise CloudError(f"there is no image, {what}", "check the profile's image, and region")
        # Dates are written so that they sort as text; where a cloud gives none, ids decide.
        dated = sorted((image.get("CreationDate", ""), image["ImageId"], image) for image in images)
        return dict(dated[-1][2])


def describe_image(image: Image) -> str:
    """Say how a cluster file names an image."""
    if image.ssm is not None:
        return f"by the parameter {image.ssm}"
    if image.name is not None:
        return f"the newest of {image.owner} called {image.name}"
    return f"by its id {image.id}"
