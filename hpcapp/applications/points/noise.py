"""The noise of a cloud before it is reconstructed, by a sample of it, as a job finds it."""

from __future__ import annotations

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import CloudMeasures, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import SAMPLED_BOX, first_share
from hpcapp.applications.surface.field.local_noise import LocalNoise
from hpcapp.applications.surface.normals.drive import orient_normals
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.resolution.estimates import choose_scale
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import PointCloud


def find_noise(cloud: PointCloud, scale: LocalScale) -> LocalNoise:
    """Find how far the points that a job takes lie off their surface, from place to place.

    Those without normals get some, in the sample. Raise InputError where they have no surface.
    """
    edge = SAMPLED_BOX * scale.spacing
    corner = lay_lattice(bound_points(cloud.positions)[0], edge)
    sample = cloud.take(
        kernels.sample_boxes(cloud.positions, corner, edge, first_share(len(cloud)))
    )
    if sample.normals is None:
        given = MemoryPass(arrange_cloud(sample)), scale.spacing, Sensor()
        sample = orient_normals(*given, keeps=False)[0].cloud.points
    return choose_scale(CloudMeasures(scale, sample), 0.0, 1.0, 1.0).noise
