"""Every fault reaches the page in one form, with the way out and without a traceback."""

from __future__ import annotations

import json
import logging
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from kinedex.explorer import application
from kinedex.explorer.answers import Json, NotFoundError
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.ops.errors import KinedexError, ParameterError, Remedy, StoreError
from kinedex.storage.interruption import TimeLimitError
from tests.explorer.conftest import Connect

FAULTS: dict[str, Exception] = {
    "plain": KinedexError("no", remedy=Remedy("run `kinedex index`", ("kinedex", "index"))),
    "store": StoreError("damaged"),
    "parameter": ParameterError("n", "positive", -1),
    "absent": NotFoundError("no such take"),
    "late": TimeLimitError("too long"),
    "file": FileNotFoundError(2, "No such file or directory", "/some/file"),
    "bug": ZeroDivisionError("secret of the program"),
}
STATUS = {"plain": 400, "store": 400, "parameter": 422, "absent": 404, "late": 408, "file": 500, "bug": 500}


class Amount(RequestBody):
    n: int


def fail(_archive: Any, request: Any) -> dict[str, Any]:
    raise FAULTS[request.path_params["kind"]]


def write(_archive: Any, asked: Amount, _request: Any) -> dict[str, Any]:
    return {"n": asked.n}


@pytest.fixture
def client(connect: Connect, monkeypatch: pytest.MonkeyPatch) -> TestClient:
    def routes_of(subject: str) -> list[Any]:
        return [get("/api/fail/{kind}", fail), post("/api/write", write, Amount, writes=True)] * (subject == "store")

    monkeypatch.setattr(application, "routes_of", routes_of)
    return connect()


@pytest.mark.parametrize("kind", list(FAULTS))
def test_a_fault_has_a_status_and_a_message(client: TestClient, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        answer = client.get(f"/api/fail/{kind}")
    error = answer.json()["error"]
    assert answer.status_code == STATUS[kind]
    assert error["type"] == type(FAULTS[kind]).__name__
    assert "Traceback" not in answer.text
    assert "secret" not in answer.text
    assert (error["remedy"] is not None) == (kind == "plain")
    assert any(record.exc_info for record in caplog.records) == (kind == "bug"), "the log alone has the traceback"


@pytest.mark.parametrize("body", ["{}", '{"n": "1"}', '{"n": 1, "m": 2}', "[", '{"n": NaN}', "\xff", "[" * 100_000])
def test_a_body_that_does_not_fit_is_named(client: TestClient, body: str) -> None:
    answer = client.post("/api/write", content=body.encode("latin-1"))
    assert answer.status_code == 422
    assert answer.json()["error"]["type"] == "ParameterError"


def test_a_wrong_method_or_address_is_a_clear_error(client: TestClient) -> None:
    assert client.get("/api/nothing").json()["error"]["type"] == "HTTPError"
    assert client.delete("/api/write").status_code in (404, 405)


def test_read_only_refuses_what_writes(connect: Connect, client: TestClient) -> None:
    assert client.post("/api/write", json={"n": 3}).json() == {"n": 3}
    answer = connect(read_only=True).post("/api/write", json={"n": 3})
    assert answer.status_code == 403
    assert "--read-only" in answer.json()["error"]["message"]


def test_json_has_no_nan_and_no_number_that_a_page_would_round() -> None:
    values = {"a": np.nan, "b": np.inf, "c": 2**53 + 1, "d": -(2**60), "e": 2**53, "f": "\ud800"}
    assert json.loads(Json(values).body) == {**values, "a": None, "b": None, "c": str(2**53 + 1), "d": str(-(2**60))}
