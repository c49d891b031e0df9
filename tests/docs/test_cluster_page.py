"""The manifest of docs/how-to/cluster.md is one that KubeRay knows.

Fields and types of RayJob and RayCluster are those of KubeRay's `apis/ray/v1` (`rayjob_types.go`,
`raycluster_types.go`); of pods, those of Kubernetes' `core/v1` that the manifest uses.
"""

import re
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "cluster.md").read_text("utf-8")
(MANIFEST,) = re.findall(r"^```yaml rayjob\.yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


class Closed(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, alias_generator=to_camel)


class Metadata(Closed):
    name: str = Field(pattern=r"^[a-z0-9]([-a-z0-9]*[a-z0-9])?$")


class Resources(Closed):
    requests: dict[Literal["cpu", "memory"], str]
    limits: dict[Literal["cpu", "memory"], str]


class Mount(Closed):
    name: str
    mount_path: str
    read_only: bool = False


class Container(Closed):
    name: str
    image: str
    resources: Resources
    volume_mounts: list[Mount] = []


class Claim(Closed):
    claim_name: str


class Volume(Closed):
    name: str
    persistent_volume_claim: Claim


class Pod(Closed):
    node_selector: dict[str, str]
    containers: list[Container]
    volumes: list[Volume] = []


class Template(Closed):
    spec: Pod


class HeadGroup(Closed):
    ray_start_params: dict[str, str]
    template: Template


class WorkerGroup(Closed):
    group_name: str
    replicas: int
    min_replicas: int
    max_replicas: int
    ray_start_params: dict[str, str]
    template: Template


class Cluster(Closed):
    ray_version: str
    head_group_spec: HeadGroup
    worker_group_specs: list[WorkerGroup]


class Job(Closed):
    entrypoint: str
    shutdown_after_job_finishes: bool
    submission_mode: Literal["K8sJobMode", "HTTPMode", "InteractiveMode"]
    backoff_limit: int
    ray_cluster_spec: Cluster


class RayJob(Closed):
    api_version: Literal["ray.io/v1"]
    kind: Literal["RayJob"]
    metadata: Metadata
    spec: Job


@pytest.fixture
def manifest():
    return YAML(typ="safe").load(MANIFEST)


def test_the_manifest_has_the_fields_of_a_ray_job(manifest):
    job = RayJob.model_validate(manifest).spec
    head = job.ray_cluster_spec.head_group_spec.template.spec
    (group,) = job.ray_cluster_spec.worker_group_specs
    (worker,) = group.template.spec.containers
    assert {mount.name for mount in head.containers[0].volume_mounts} == {
        volume.name for volume in head.volumes
    }
    # One image and one kind of machine: others would be refused by name.
    assert worker.image == head.containers[0].image
    assert group.template.spec.node_selector == head.node_selector
    assert group.ray_start_params["num-cpus"] == worker.resources.requests["cpu"]


def test_a_field_that_is_none_of_theirs_is_found(manifest):
    manifest["spec"]["rayClusterSpec"]["workerGroupSpec"] = []
    with pytest.raises(ValidationError, match=r"workerGroupSpec\n.*not permitted"):
        RayJob.model_validate(manifest)


def test_versions_of_ray_are_those_of_the_constraints(manifest):
    (pinned,) = re.findall(r"^ray==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert manifest["spec"]["rayClusterSpec"]["rayVersion"] == pinned
    assert f"rayproject/ray:{pinned}-" in PAGE
