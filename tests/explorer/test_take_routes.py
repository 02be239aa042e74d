"""Addresses of a take: binary answers, and errors that name the parameter."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from tests.explorer.conftest import Connect
from tests.pipelines.labelled import motion


def test_a_take_is_found_by_name_and_its_motion_and_words_are_binary(connect: Connect) -> None:
    client = connect()
    take = client.get("/api/take", params={"name": "al_long"}).json()
    assert take["name"] == "al_long"
    assert "kinedex sql" in take["command"]
    words = np.frombuffer(client.get(f"/api/takes/{take['take_id']}/words").content, "<u8")
    np.testing.assert_array_equal(words, np.concatenate([motion("walk"), motion("kick")]))
    answer = client.get(f"/api/takes/{take['take_id']}/motion", params={"first": 4, "stop": 10, "step": 2})
    assert struct.unpack_from("<4s4I", answer.content) == (b"KNX1", 3, 24, 4, 2)
    figures = client.post("/api/figures", json={"items": [{"take_id": take["take_id"], "start": 0, "stop": 9}]})
    assert struct.unpack_from("<II4s", figures.content)[0::2] == (1, b"KNX1")


@pytest.mark.parametrize(
    ("address", "status", "message"),
    [
        ("/api/take?name=al_lonk", 404, "did you mean 'al_long'"),
        ("/api/takes/99", 404, "no take has the id 99"),
        ("/api/takes/1/motion?first=ten", 422, "first must be a whole number in the address"),
        ("/api/takes/1/motion?first=0&stop=9999", 422, "first and stop must be a range within"),
        ("/api/takes/1/pose", 422, "frame must be a whole number"),
        ("/api/takes/1/curve?template=walk&kind=middling", 422, "kind must be soft or hard"),
        ("/api/takes/1/curve?template=walk&delta=nan", 422, "delta must be a number in the address"),
        ("/api/takes/1/curve?template=walk", 400, "has no templates yet"),
    ],
)
def test_a_wrong_question_is_an_error_that_names_what_is_wrong(
    connect: Connect, address: str, status: int, message: str
) -> None:
    answer = connect().get(address)
    assert answer.status_code == status
    assert message in answer.json()["error"]["message"]


def test_too_many_figures_and_unknown_fields_are_refused(connect: Connect) -> None:
    one = {"take_id": 1, "start": 0, "stop": 5}
    for body in ({"items": [one] * 501}, {"items": [one], "size": 3}, {"items": [{**one, "start": "0"}]}):
        assert connect().post("/api/figures", json=body).status_code == 422
