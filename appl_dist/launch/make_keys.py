"""`appl-dist keys FOLDER`: a certificate authority, certificates and passwords for one run; see wire/credentials.py."""

from __future__ import annotations

import datetime
import ipaddress
import os
import secrets
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from appl_dist.arguments import ArgumentParser
from appl_dist.errors import UserError
from appl_dist.files import explain
from appl_dist.wire.credentials import (
    ACTOR,
    AUTHORITY,
    CA_FILE,
    CERTIFICATE_FILE,
    KEY_FILE,
    LEARNER,
    PASSWORD_FILE,
    USERS_FILE,
    VIEWER,
)
from appl_dist.wire.key_expressions import is_name

_ALWAYS = ("localhost", "127.0.0.1", "::1")
_PASSWORD_BYTES = 24
_CLOCK_SKEW = datetime.timedelta(hours=1)


def main(arguments: list[str]) -> int:
    """Make what is missing in the folder; what is there stays."""
    parser = ArgumentParser(prog="appl-dist keys", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--host", action="append", default=[], help="name or address actors reach the learner by")
    parser.add_argument("--actors", type=int, default=0, help="actor-0 to actor-N-1 (default: one shared by all)")
    parser.add_argument("--actor", action="append", default=[], help="an actor identity of this name")
    parser.add_argument("--days", type=int, default=90, help="how long certificates are valid (default 90)")
    options = parser.parse_args(arguments)
    if not 0 <= options.actors <= 100_000 or not 1 <= options.days <= 3650:
        raise UserError(f"keys: got --actors {options.actors} --days {options.days}; allowed 0..100000, 1..3650")
    names = [*options.actor, *(f"actor-{i}" for i in range(options.actors))]
    made = make_keys(options.folder, options.host, names, options.days)
    for name in made:
        print(f"{options.folder / name}")
    print(
        f"made {len(made)}; hand a machine only the folder of its identity, and start with\n"
        f"  appl-dist learner wire=tls wire.keys={options.folder}\n"
        f"  appl-dist actor wire=tls wire.keys={options.folder} wire.endpoint=tls/HOST:7447"
    )
    return 0


def make_keys(folder: Path, hosts: list[str], actors: list[str], days: int = 90) -> list[str]:
    """Names of the identities made now. Without `actors`, and none there yet, one named actor."""
    wrong = [name for name in actors if not is_name(name) or name in (LEARNER, VIEWER, AUTHORITY)]
    if wrong:
        raise UserError(f"keys: {wrong[0]!r} cannot be an actor's name")
    try:
        authority = _Authority(folder / AUTHORITY, days)
        users = folder / LEARNER / USERS_FILE
        if not actors and not users.exists():
            actors = [ACTOR]
        names = [name for name in (LEARNER, VIEWER, *actors) if not (folder / name / PASSWORD_FILE).exists()]
        listed = users.read_text("utf-8") if users.exists() else ""
        for name in names:
            authority.issue(folder / name, [*hosts, *_ALWAYS] if name == LEARNER else [])
            password = secrets.token_urlsafe(_PASSWORD_BYTES)
            _write(folder / name / PASSWORD_FILE, f"{name}:{password}\n".encode())
            listed += f"{name}:{password}\n"
        _write(users, listed.encode())
    except OSError as error:
        raise UserError(f"{error.filename or folder}: cannot be written: {explain(error)}") from None
    return names


class _Authority:
    """The run's certificate authority, made at the first use."""

    def __init__(self, folder: Path, days: int) -> None:
        self._days = days
        if (folder / KEY_FILE).exists():
            try:
                key = serialization.load_pem_private_key((folder / KEY_FILE).read_bytes(), None)
                self._certificate = x509.load_pem_x509_certificate((folder / CA_FILE).read_bytes())
            except ValueError as error:
                raise UserError(f"keys: {folder} is damaged ({error}); choose an empty folder") from None
            assert isinstance(key, ec.EllipticCurvePrivateKey)
            self._key = key
            return
        self._key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"appl-dist {secrets.token_hex(4)}")
        self._certificate = (
            _builder(name, name, self._key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(certificates=True), critical=True)
            .sign(self._key, hashes.SHA256())
        )
        _write(folder / CA_FILE, _pem(self._certificate))
        _write(folder / KEY_FILE, _pem_key(self._key))

    def issue(self, folder: Path, hosts: list[str]) -> None:
        """A key and certificate for the identity named like the folder; `hosts`: what it may be reached as."""
        key = ec.generate_private_key(ec.SECP256R1())
        purpose = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
        alternatives = [_host(host) for host in hosts or [folder.name]]
        builder = (
            _builder(_name(folder.name), self._certificate.subject, key.public_key(), self._days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
            .add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
        )
        _write(folder / KEY_FILE, _pem_key(key))
        _write(folder / CERTIFICATE_FILE, _pem(builder.sign(self._key, hashes.SHA256())))
        _write(folder / CA_FILE, _pem(self._certificate))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_SKEW)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _usage(certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not certificates,
        key_cert_sign=certificates,
        crl_sign=certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _pem_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all, and never readable by others, not even for a moment."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    partial = path.with_name(f"{path.name}.tmp")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
        file.write(data)
    os.replace(partial, path)
