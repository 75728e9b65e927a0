"""The example files are valid, and so is the one that the page shows."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from hpccomponent.errors import ConfigError
from hpcdeploy.spec.cluster import read_spec
from hpcdeploy.spec.provider import AwsSpec, Ec2Spec, EucalyptusSpec, LocalSpec, SshSpec

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "deploy/hpcdeploy/examples").glob("*.yaml"))
PROVIDERS = (AwsSpec, EucalyptusSpec, Ec2Spec, SshSpec, LocalSpec)


def test_there_is_an_example_for_each_provider() -> None:
    types = {read_spec(path).provider.type for path in EXAMPLES}
    assert types == {get_args(kind.model_fields["type"].annotation)[0] for kind in PROVIDERS}


def test_the_papers_table_1_has_a_head_that_works_and_three_workers() -> None:
    spec = read_spec(ROOT / "deploy/hpcdeploy/examples/paper-table-1.yaml")
    assert spec.head.component
    assert spec.worker_count == spec.worker_min == 3


def test_the_pages_file_is_valid_and_its_mistakes_are_told_so(tmp_path: Path) -> None:
    page = (ROOT / "docs/how-to/describe-a-cluster.md").read_text(encoding="utf-8")
    _, _, text = page.partition("## The file\n```yaml\n")
    text, _, after = text.partition("```\n")
    told = after.split("```\n")[1]
    path = tmp_path / "cluster.yaml"
    path.write_text(text)
    assert read_spec(path).worker_count == 3
    path.write_text(text.replace("{profile: small", "{profile: smal").replace("idle", "idel"))
    with pytest.raises(ConfigError) as caught:
        read_spec(path)
    assert str(caught.value).replace(f"{tmp_path}/", "") + "\n" == told
