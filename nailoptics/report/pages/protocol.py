"""The page of a protocol: the line to follow, with a bar of the measured force where that is piped in."""

import json
import math
from collections.abc import Callable, Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

from ...errors import InputError
from ...scene.protocol import Protocol, is_off
from ...version import code_attributes
from ..html import Html, Script, document, file_text, section, small, texts


def page(drawn: Protocol, *, is_served: bool = False, **made: Any) -> str:
    """The page as text; one that is served shows the force at its server's address `force`, too.

    made : what makes the protocol again, beside this program.
    """
    columns = {name: column.tolist() for name, column in drawn._asdict().items()}
    columns["is_off"] = is_off(drawn.time_s, drawn.time_s, drawn.force_n).tolist()
    data, words = json.dumps(columns | {"is_served": is_served}), texts("protocol")
    player, script = (file_text(f"pages/protocol.{kind}") for kind in ("html", "js"))
    player += f'<script type="application/json" id="protocol">{data}</script>'
    runs = Script(script)
    runs.is_served = is_served
    body = [section("The line", Html(player), small(words["live"])), runs]
    lead = f"{words['lead']} {words['donnings'] if any(columns['is_off']) else words['kept_on']}"
    return document(**words["page"], lead=lead, body=body, attributes=code_attributes() | made)


def live_columns(header: list[str]) -> tuple[str, str]:
    """What `serve` reads; raises InputError of a header that lacks it."""
    for title in ("time_s", "force_n"):
        if title not in header:
            raise InputError(f"stdin: has no column {title}; pipe lines of time_s,force_n, with these as header.")
    return "time_s", "force_n"


def serve(drawn: Protocol, samples: Iterable[dict[str, float]], say: Callable[[str], None], **made: Any) -> None:
    """Serve the page to browsers of this machine alone, and say where, until the samples end: time_s and force_n.

    The line begins with the first sample; where a force is missing the one before it stays.
    """
    text, newest, first_s = page(drawn, is_served=True, **made), dict[str, float](), None

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            is_force = self.path == "/force"
            self.send_response(200)
            self.send_header("Content-Type", "application/json" if is_force else "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write((json.dumps(newest) if is_force else text).encode())

        def log_message(self, *_: object) -> None:
            """Say nothing of requests."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        say(f"the line and the measured force: http://127.0.0.1:{server.server_port}/")
        try:
            for sample in samples:
                first_s = sample["time_s"] if first_s is None else first_s
                if math.isfinite(sample["force_n"]):
                    newest = {"time_s": sample["time_s"] - first_s, "force_n": sample["force_n"]}
        finally:
            server.shutdown()
