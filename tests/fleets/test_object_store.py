"""Recordings of an object store, on a server of this machine that speaks its protocol."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import boto3
import pytest
import s3fs
from moto.server import ThreadedMotoServer
from tests.machines import drag_fleet as drives

import riecjax as rx
from riecjax.fleets import order
from riecjax.fleets.report import Fleet

MODEL = rx.find_model("drag-oscillator")
KEYS = {"AWS_ACCESS_KEY_ID": "any", "AWS_SECRET_ACCESS_KEY": "any", "AWS_REGION": "us-east-1"}


@pytest.fixture
def address(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Of the store; processes that are started find it and the keys in their environment."""
    for name, value in KEYS.items():
        monkeypatch.setenv(name, value)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    yield f"http://{host}:{port}"
    server.stop()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def client(address: str) -> Any:
    client = boto3.client("s3", endpoint_url=address, region_name="us-east-1")
    client.create_bucket(Bucket="garage")
    return client


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for vehicle in range(2):
        own = tmp_path / f"drives/vehicle={vehicle}"
        own.mkdir(parents=True)
        for i, record in enumerate(drives(2, 1500, 20 + vehicle)):
            rx.write_record(own / f"{i}.parquet", record)
    return tmp_path / "drives"


def values(found: Fleet) -> dict[tuple[str, str | None], float | None]:
    return {(e.group, e.parameter): e.value for e in found.entries if e.status == "ok"}


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_recordings_of_an_object_store_are_summed(folder, client, tmp_path, monkeypatch, workers):
    for file in folder.rglob("*.parquet"):
        client.upload_file(str(file), "garage", file.relative_to(folder).as_posix())
    client.put_object(Bucket="garage", Key="vehicle=1/broken.parquet", Body=b"PAR1, but no more")
    out = tmp_path / "out"
    by_vehicle = partial(rx.fleet, MODEL, by="vehicle", intervals="sandwich")
    found = by_vehicle("s3://garage/**/*.parquet", workers=workers, out=out)
    here = by_vehicle(folder, workers=0, out=tmp_path / "here")
    assert values(found) == values(here)
    (failed,) = found.failures
    assert "broken.parquet" in failed.name
    # What the store says of a file tells whether it has changed since.
    client.upload_file(str(folder / "vehicle=1/0.parquet"), "garage", "vehicle=0/0.parquet")
    read, rows_of = [], order.rows_of
    monkeypatch.setattr(
        order, "rows_of", lambda o, p: [read.append(p.source.name), *rows_of(o, p)][1:]
    )
    again = by_vehicle("s3://garage/**/*.parquet", workers=0, out=out)
    assert sorted(read) == ["vehicle=0/0.parquet", "vehicle=1/broken.parquet"]
    assert values(again) != values(found)


def test_a_store_that_is_gone_is_said_in_a_line(client, address, monkeypatch):
    client.put_object(Bucket="garage", Key="0.csv", Body=b"t,x\n0,1\n")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    with pytest.raises(rx.DataError, match=r"'s3://garage/\*.csv' cannot be looked at: .*endpoint"):
        rx.fleet(MODEL, "s3://garage/*.csv", workers=0)
