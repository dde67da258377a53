"""
A study on another address than this machine's own: by TLS alone, with a certificate that the test
signs itself.

Oracle: Python's own TLS client, which checks certificate and name.
"""

import http.client
import json
import shutil
import socket
import ssl
import subprocess
from contextlib import suppress

import pytest

from trustlab.live.study.server import StudyServer


@pytest.fixture(scope="module")
def signed(tmp_path_factory):
    """Certificate and key for the name localhost."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl: apt-get install openssl")
    folder = tmp_path_factory.mktemp("tls")
    certificate, key = folder / "cert.pem", folder / "key.pem"
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    who = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    command = [
        "openssl",
        "req",
        "-x509",
        *curve,
        *who,
        "-keyout",
        str(key),
        "-out",
        str(certificate),
    ]
    subprocess.run(command, check=True, capture_output=True)
    return certificate, key


def asked(server, certificate, path, body=None, **headers):
    """
    Return status and answer of a request by a client that trusts this certificate and no other.
    """
    context = ssl.create_default_context(cafile=certificate)
    link = http.client.HTTPSConnection("localhost", server.port, context=context, timeout=30)
    try:
        link.request(
            "GET" if body is None else "POST",
            path,
            None if body is None else json.dumps(body),
            headers,
        )
        answer = link.getresponse()
        return answer.status, answer.read()
    finally:
        link.close()


def test_a_study_is_served_by_tls_on_every_address(make_plan, signed):
    certificate, key = signed
    with StudyServer(
        make_plan(), "0.0.0.0", certificate=certificate, key=key, names=["localhost"]
    ) as server:
        link = server.links()["P01"]
        origin, _, path = link.partition("/p/")
        assert origin == f"https://localhost:{server.port}"
        status, page = asked(server, certificate, f"/p/{path}")
        assert status == 200
        assert b"study.js" in page
        kind = {"Content-Type": "application/json"}
        answers = {"page": 0, "answers": {"consent": True}}
        assert (
            asked(server, certificate, f"/p/{path}/answers", answers, **kind, Origin=origin)[0]
            == 200
        )
        plain = origin.replace("https", "http")
        assert (
            asked(server, certificate, f"/p/{path}/answers", answers, **kind, Origin=plain)[0]
            == 403
        )
        assert asked(server, certificate, f"/p/{path}", Host="evil.example")[0] == 421
        with pytest.raises(ssl.SSLCertVerificationError):
            asked(server, None, f"/p/{path}")  # a client that does not know who signed it
        with socket.create_connection(("127.0.0.1", server.port), timeout=30) as unencrypted:
            unencrypted.sendall(
                f"GET /p/{path} HTTP/1.1\r\nHost: localhost:{server.port}\r\n\r\n".encode()
            )
            with suppress(ConnectionResetError):
                assert unencrypted.recv(1000) == b"", "what is not encrypted gets no answer"


def test_a_certificate_that_cannot_be_used_is_an_error_that_names_it(make_plan, signed, tmp_path):
    plan, (certificate, key) = make_plan(), signed
    with pytest.raises(ValueError, match="no use without certificate="):
        plan.serve(key=key)
    with pytest.raises(ValueError, match=r"missing\.pem.*cannot be used for TLS"):
        plan.serve("0.0.0.0", certificate=tmp_path / "missing.pem", key=key)
    with pytest.raises(ValueError, match=r"key.*cannot be used for TLS"):
        plan.serve("0.0.0.0", certificate=certificate, key=certificate)
