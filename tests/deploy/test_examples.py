"""The example files are valid, and the page about them names every key with its default."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic_core import PydanticUndefined

from hpccomponent.config.reader import ConfigModel
from hpccomponent.errors import ConfigError
from hpccomponent.units import parse_duration
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.provider import AwsSpec, Ec2Spec, EucalyptusSpec, LocalSpec, SshSpec

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "deploy/examples").glob("*.yaml"))
PROVIDERS = (AwsSpec, EucalyptusSpec, Ec2Spec, SshSpec, LocalSpec)


def test_there_is_an_example_for_each_provider() -> None:
    types = {read_spec(path).provider.type for path in EXAMPLES}
    assert types == {get_args(kind.model_fields["type"].annotation)[0] for kind in PROVIDERS}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_valid(path: Path) -> None:
    assert read_spec(path).nodes()[0] == "head"


def test_the_papers_table_1_has_a_head_that_works_and_three_workers() -> None:
    spec = read_spec(ROOT / "deploy/examples/paper-table-1.yaml")
    assert spec.head.component
    assert spec.worker_count == spec.worker_min == 3


def models_in(annotation: Any) -> Iterator[type[ConfigModel]]:
    """Yield the models that a key's value may be, be it alone, in a list or in a mapping."""
    if isinstance(annotation, type) and issubclass(annotation, ConfigModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_in(inner)


def keys_of(model: type[ConfigModel], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every key below a model, dotted, with its default where that is a plain value."""
    for name, field in model.model_fields.items():
        key = f"{above}{name}"
        models = list(models_in(field.annotation))
        if not models:
            yield key, field.default
        many = {"profiles": ".NAME", "hosts": "[]"}.get(name, "")
        for inner in models:
            yield from keys_of(inner, f"{key}{many}.")


def rows_of(head: str) -> Iterator[list[str]]:
    """Yield the cells of the page's tables of keys that begin so."""
    page = (ROOT / "docs/how-to/run-on-a-cluster.md").read_text(encoding="utf-8")
    tables = [block for block in page.split("\n\n") if block.startswith(head)]
    for line in (line for table in tables for line in table.splitlines()[2:]):
        yield [cell.strip() for cell in line.split("|")[1:]]


def reference() -> dict[str, str]:
    """Return what the page says of keys: key to default."""
    return {row[0].strip("`"): row[1] for row in rows_of("| key | default |")}


def test_the_pages_file_is_valid_and_its_mistakes_are_told_so(tmp_path: Path) -> None:
    page = (ROOT / "docs/how-to/run-on-a-cluster.md").read_text(encoding="utf-8")
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


def test_the_page_names_every_key_and_none_that_is_not_there() -> None:
    assert set(reference()) == {key for key, _ in keys_of(ClusterSpec)}


def test_the_page_tells_with_which_providers_a_key_counts() -> None:
    told = {row[0].strip("`"): row[2] for row in rows_of("| key | default | counts with |")}
    del told["provider.type"]
    assert told.keys() | {"provider"} == AwsSpec.honours
    for key, providers in told.items():
        expected = [name for name, kind in (("`ssh`", SshSpec), ("`local`", LocalSpec))
                    if key in kind.honours]  # fmt: skip
        clouds = ", ".join(["clouds", *expected])
        assert providers == ("all" if len(expected) == 2 else clouds), key


@pytest.mark.parametrize(("key", "default"), sorted(set(keys_of(ClusterSpec)), key=str))
def test_the_page_tells_the_default(key: str, default: Any) -> None:
    told = reference()[key]
    if key.startswith("limits.") and isinstance(default, float):
        assert parse_duration(told.strip("`")) == default
    elif default is PydanticUndefined:
        assert told in ("required", "`{}`") or "required" in told
    elif isinstance(default, str | int) and not isinstance(default, bool):
        assert f"`{default}`" in told
    elif isinstance(default, bool):
        assert told == f"`{str(default).lower()}`"
    elif isinstance(default, tuple):
        assert told == f"`[{', '.join(default)}]`"
    else:
        assert told  # in words: it depends on other keys
