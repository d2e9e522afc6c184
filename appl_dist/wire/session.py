"""The bus over zenoh: the learner is the router and listens, everyone else is a client.

The only module that imports zenoh. No separate router process is needed; scouting is off, so processes meet
only at the endpoint given. Shared memory is off: queries through it can be dropped in silence under load
(zenoh issue 2628).
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import zenoh

from appl_dist.errors import PassingFault, UserError
from appl_dist.wire.access import access_control, rate_limits, size_limits
from appl_dist.wire.bus import Handle, Message, Query
from appl_dist.wire.credentials import CA_FILE, CERTIFICATE_FILE, KEY_FILE, LEARNER, USERS_FILE, Identity, find
from appl_dist.wire.wire_settings import MAX_ACTORS, MAX_CONNECTIONS, WireSettings

log = logging.getLogger(__name__)

_MAX_MESSAGE_BYTES = 64 << 20  # refused by the transport itself, before anything of ours sees it


class EndpointInUse(UserError):
    """Another process listens where the learner was to."""


def open_session(settings: WireSettings, listen: bool, identity: str = "") -> Session:
    """A connected session; UserError when the endpoint is taken (listen) or no learner answers at it.

    identity: whose credentials to use where the settings ask for any and name none; see `credentials.find`.
    """
    if settings.security != "password":  # zenoh's log would hold it
        zenoh.init_log_from_env_or("off")  # refusals reach users as our sentences; RUST_LOG shows zenoh's own
    config = zenoh.Config.from_json5(json.dumps(_config(settings, listen, identity)))
    try:
        return Session(_open(config))
    except zenoh.ZError as error:
        kind = (EndpointInUse if "in use" in str(error) else UserError) if listen else PassingFault
        raise kind(_why(settings, listen, str(error))) from error


def _open(config: zenoh.Config) -> zenoh.Session:
    """`zenoh.open` in a thread of its own: in the main thread no signal would be heard until it gives up."""
    opened: Future[zenoh.Session] = Future()

    def run() -> None:
        try:
            opened.set_result(zenoh.open(config))
        except BaseException as error:
            opened.set_exception(error)

    threading.Thread(target=run, name="zenoh-open", daemon=True).start()
    return opened.result()


def _why(settings: WireSettings, listen: bool, error: str) -> str:
    if listen and "in use" in error:
        return (
            f"wire.endpoint: {settings.endpoint} is already in use by another process; "
            "choose another port, as in wire.endpoint=tcp/127.0.0.1:7448"
        )
    if listen:
        return f"wire.endpoint: cannot listen on {settings.endpoint}: {error.split(' at /', 1)[0]}"
    return (
        f"wire.endpoint: no learner answered at {settings.connect_endpoint} within {settings.timeout_s:g} s: no "
        "learner runs there, or it refused the credentials (user, password or certificates), or it already has its "
        f"{MAX_ACTORS:,} actors; the wire does not say which"
    )


def _config(settings: WireSettings, listen: bool, identity: str) -> dict[str, Any]:
    lease_ms = round(settings.lease_s * 1000)
    transport: dict[str, Any] = {
        "shared_memory": {"enabled": False},
        "unicast": {
            "accept_pending": MAX_CONNECTIONS,  # the default of 100 refuses part of a large fleet's start
            "max_sessions": MAX_CONNECTIONS,
            "open_timeout": round(settings.timeout_s * 1000),
            "accept_timeout": round(settings.timeout_s * 1000),
        },
        "link": {
            "rx": {"max_message_size": _MAX_MESSAGE_BYTES},
            "tx": {
                "lease": lease_ms,
                "keep_alive": 4,
                # How long one stalled receiver may hold up a blocking put, in µs.
                "queue": {"congestion_control": {"block": {"wait_before_close": lease_ms * 1000}}},
            },
        },
    }
    config: dict[str, Any] = {
        "mode": "router" if listen else "client",
        "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "transport": transport,
    }
    users = None
    if not settings.is_open:
        who = find(settings.keys, LEARNER if listen else settings.identity or identity)
        if settings.security == "tls":
            transport["link"]["tls"] = _tls(who, listen)
        else:
            transport["auth"] = {"usrpwd": _password(who, listen)}
        users = who.users() if listen else None
    if listen:
        config["listen"] = {"endpoints": [settings.endpoint], "timeout_ms": 0, "exit_on_failure": True}
        config["access_control"] = access_control(
            users, "cert_common_names" if settings.security == "tls" else "usernames"
        )
        config["low_pass_filter"] = size_limits()
        config["downsampling"] = rate_limits()
    else:
        config["connect"] = {
            "endpoints": [settings.connect_endpoint],
            "timeout_ms": round(settings.timeout_s * 1000),
            "exit_on_failure": True,
            "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        }
    return config


def _tls(who: Identity, listen: bool) -> dict[str, Any]:
    side = "listen" if listen else "connect"
    return {
        "root_ca_certificate": who.path(CA_FILE),
        f"{side}_certificate": who.path(CERTIFICATE_FILE),
        f"{side}_private_key": who.path(KEY_FILE),
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }


def _password(who: Identity, listen: bool) -> dict[str, str]:
    if listen:
        return {"dictionary_file": who.path(USERS_FILE)}
    user, password = who.password()
    return {"user": user, "password": password}


class Session:
    """A `bus.Bus` over one zenoh session. A client reconnects by itself; its tokens then stand again."""

    def __init__(self, session: Any) -> None:
        self._session = session
        self.identity = str(session.zid())

    def put(self, key: str, payload: bytes, attachment: bytes = b"", block: bool = False) -> None:
        control = zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP
        try:
            self._session.put(key, payload, attachment=attachment or None, congestion_control=control)
        except zenoh.ZError as error:
            log.debug("put %s: %s", key, error)

    def get(self, key: str, payload: bytes = b"", attachment: bytes = b"", timeout_s: float = 5.0) -> Message | None:
        try:
            replies = self._session.get(
                key,
                payload=payload,
                attachment=attachment or None,
                timeout=timeout_s,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for reply in replies:
                if reply.ok is not None:
                    return _Received(reply.ok)
        except zenoh.ZError as error:
            log.debug("get %s: %s", key, error)
        return None

    def subscribe(self, key: str, callback: Callable[[Message], None]) -> Handle:
        def receive(sample: Any) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                callback(_Received(sample))

        return _Handle(self._session.declare_subscriber(key, _guarded(receive)))

    def serve(self, key: str, callback: Callable[[Query], None]) -> Handle:
        return _Handle(self._session.declare_queryable(key, _guarded(lambda query: callback(_ReceivedQuery(query)))))

    def announce(self, key: str) -> Handle:
        return _Handle(self._session.liveliness().declare_token(key))

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        def receive(sample: Any) -> None:
            callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        return _Handle(self._session.liveliness().declare_subscriber(key, _guarded(receive), history=True))

    def close(self) -> None:
        """Close the connection; a thread waiting in `get` returns. May be called twice."""
        try:
            if not self._session.is_closed():
                self._session.close()
        except zenoh.ZError as error:
            log.debug("close: %s", error)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _guarded(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    def call(argument: Any) -> None:
        try:
            callback(argument)
        except Exception:  # zenoh would print it and go on; a log line can be found
            log.exception("callback of the wire failed")

    return call


class _Received:
    def __init__(self, message: Any) -> None:
        self._message = message

    @property
    def key(self) -> str:
        return str(self._message.key_expr)

    @property
    def size(self) -> int:
        payload = self._message.payload
        return 0 if payload is None else len(payload)

    @property
    def payload(self) -> bytes:
        payload = self._message.payload
        return b"" if payload is None else bytes(payload.to_bytes())

    @property
    def attachment(self) -> bytes:
        attachment = self._message.attachment
        return b"" if attachment is None else bytes(attachment.to_bytes())


class _ReceivedQuery(_Received):
    def reply(self, payload: bytes, attachment: bytes = b"") -> None:
        try:
            with self._message as query:  # leaving the block tells the sender that no more answers come
                query.reply(query.key_expr, payload, attachment=attachment or None)
        except Exception as error:  # the sender has gone, or a second answer
            log.debug("reply: %s", error)


class _Handle:
    def __init__(self, declared: Any) -> None:
        self._declared = declared
        self._lock = threading.Lock()

    def close(self) -> None:
        with self._lock:
            declared, self._declared = self._declared, None
        if declared is None:
            return
        try:
            declared.undeclare()
        except zenoh.ZError as error:  # its session closed first
            log.debug("undeclare: %s", error)
