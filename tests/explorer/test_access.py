"""Nobody else's page, name or program reads an archive through the explorer, and what it sends is text to the page."""

from __future__ import annotations

import re

import pytest

from kinedex.explorer.access import MAX_BYTES, Rules, address, is_loopback
from tests.explorer.conftest import HOST, PORT, TOKEN, Connect


def test_the_token_opens_the_page_and_leaves_the_address(connect: Connect) -> None:
    client = connect(token=None)
    answer = client.get(f"/take/a%20b?token={TOKEN}&from=3&note=")
    assert (answer.status_code, answer.headers["location"]) == (303, "/take/a%20b?from=3&note=")
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"kinedex-{PORT}={TOKEN};")
    assert {"HttpOnly", "SameSite=strict"} <= set(cookie.split("; "))
    assert client.get("/api/store").status_code == 200, "the cookie is enough from now on"


def test_no_redirect_leads_to_another_site(connect: Connect) -> None:
    answer = connect(token=None).get(f"{HOST}//evil.example/x?token={TOKEN}")
    assert answer.headers["location"] == "/evil.example/x"


@pytest.mark.parametrize("headers", [{}, {"authorization": "Bearer wrong"}, {"cookie": f"kinedex-{PORT}=wrong"}])
def test_without_the_token_nothing_is_read(connect: Connect, headers: dict[str, str]) -> None:
    client = connect(token=None)
    for path in ("/", "/api/store", "/assets/a.js", "/api/store?token=wrong", "/api/events"):
        answer = client.get(path, headers=headers)
        assert answer.status_code == 401
        assert "kinedex explore" in answer.text


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8734", "127.0.0.1.evil.example", "", "[::1", "10.0.0.1"]
)
def test_a_name_that_is_not_ours_is_refused(connect: Connect, host: str) -> None:
    answer = connect().get("/api/store", headers={"host": host})
    assert answer.status_code == 403
    assert "localhost" in answer.json()["error"]["message"]


@pytest.mark.parametrize("host", ["localhost:8734", "127.0.0.1:9999", "[::1]:8734"])
def test_our_names_are_known_also_behind_a_tunnel(connect: Connect, host: str) -> None:
    assert connect().get("/api/store", headers={"host": host}).status_code == 200


FOREIGN = [
    {"origin": "https://evil.example"},
    {"origin": "http://127.0.0.1:9999"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "cors"},
    {"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},
]


@pytest.mark.parametrize("headers", FOREIGN)
def test_another_site_can_ask_for_nothing(connect: Connect, headers: dict[str, str]) -> None:
    client = connect()
    assert client.get("/api/store", headers=headers).status_code == 403
    assert client.post("/api/takes", json={}, headers=headers).status_code == 403


def test_our_own_page_and_plain_navigation_are_let_in(connect: Connect) -> None:
    client = connect()
    ours = {"origin": HOST, "sec-fetch-site": "same-origin", "sec-fetch-mode": "cors"}
    assert client.post("/api/takes", json={}, headers=ours).status_code == 200
    assert client.get("/", headers={"sec-fetch-site": "none", "sec-fetch-mode": "navigate"}).status_code == 200
    assert client.get("/", headers={"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}).status_code == 200


def test_every_answer_has_the_policy_and_a_new_nonce(connect: Connect) -> None:
    client = connect()
    nonces = set()
    for path in ("/", "/", "/api/store", "/assets/a.js", "/api/no/such"):
        answer = client.get(path)
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self';")
        assert "unsafe" not in policy
        (nonce,) = re.findall(r"'nonce-([^']+)'", policy)
        nonces.add(nonce)
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["x-frame-options"] == "DENY"
        if path == "/":
            assert f'content="{nonce}"' in answer.text
    assert len(nonces) == 5


def test_only_files_of_the_page_are_served(connect: Connect) -> None:
    client = connect()
    assert client.get("/assets/a.js").headers["cache-control"].endswith("immutable")
    for path in ("/assets/../secret.txt", "/assets/..%2fsecret.txt", "/assets/%2e%2e/secret.txt", "/assets/b.js"):
        assert "nobody asks" not in client.get(path).text
    assert client.get("/assets/b.js").status_code == 404


def test_a_body_that_is_too_long_is_refused_whatever_it_announces(connect: Connect) -> None:
    client = connect()
    assert client.post("/api/takes", content=b" " * (MAX_BYTES + 1)).status_code == 413
    chunks = (b" " * 2**20 for _ in range(MAX_BYTES // 2**20 + 1))
    assert client.post("/api/takes", content=chunks).status_code == 413
    assert client.post("/api/takes", content=b"{}", headers={"content-length": "-1"}).status_code in (400, 413)


def test_other_machines_may_use_addresses_but_no_foreign_name() -> None:
    rules = Rules.for_host("t", "0.0.0.0", 80)
    assert rules.is_known_host("192.168.7.9:80")
    assert rules.is_known_host("localhost:80")
    assert not rules.is_known_host("evil.example")
    assert not Rules.for_host("t", "127.0.0.1", 80).open_to_others


@pytest.mark.parametrize(
    ("host", "alone"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False)]
)
def test_loopback_is_this_machine_alone(host: str, alone: bool) -> None:
    assert is_loopback(host) is alone


def test_the_address_names_a_host_that_a_browser_finds() -> None:
    assert address(Rules("t", 80), "::1") == "http://[::1]:80/?token=t"
    assert "0.0.0.0" not in address(Rules("t", 80), "0.0.0.0")
