"""A folder with the keys of one measurement: an authority of its own, and what it signed for ping and relay.

It has the layout of a ROS 2 keystore: `enclaves/ping/{cert,key}.pem` and so on. Nothing of it is written to a trace but a
hash of what is public. Governance and permissions are XML (DDS Security 1.1, 9.4).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.files import read_regular

from ..choices import Security

VARIABLE = "DDS_TRACE_KEYS"
"""Folder with a folder of keys for each level, which a sweep makes for its programs."""

LAST_SECURED_DOMAIN = 230
"""Cyclone DDS 0.10 reads no governance for higher ids."""

_SCHEMAS = "https://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{}.xsd"
_ROOT = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="{schema}">\n{content}\n</dds>\n'
)
_DOMAINS = f"<domains><id_range><min>0</min><max>{LAST_SECURED_DOMAIN}</max></id_range></domains>"

_PROTECTED = {
    Security.AUTHENTICATE: {},
    Security.SIGN: {"rtps": "SIGN"},
    Security.ENCRYPT_DATA: {"data": "ENCRYPT"},
    Security.ENCRYPT_RTPS: {"rtps": "ENCRYPT"},
}
"""Level -> kind of protection of whole packets (`rtps`) or of the payload (`data`); all levels authenticate."""

SIDES = ("ping", "relay")
LEVEL_FILE = "level"
_VALID = timedelta(days=400)
_FOLDER = re.compile(r"dds-trace-keys-(\d+)-\w+")


def enclave(keys: str, *, listens: bool) -> Path:
    return Path(keys).absolute() / "enclaves" / SIDES[listens]


def public_hash(keys: str) -> str:
    files = [path for path in sorted(Path(keys).rglob("*")) if path.name != "key.pem" and path.is_file()]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()


@contextmanager
def opened_keys(level: Security, folder: str | None) -> Iterator[str | None]:
    """Yield the folder of keys of a recording, made and removed by the one that finds none; None without security."""
    if level is Security.OFF:
        yield None
        return
    shared = os.environ.get(VARIABLE)
    path = Path(folder) if folder else Path(shared) / level.value if shared else None
    if path is None:
        raise OptionError(
            f"-o security={level.value} needs -o keys=FOLDER, the same for both sides; a folder that is not there yet is made, and "
            "removed at the end"
        )
    is_ours = not path.exists()
    if is_ours:
        make_keys(path, level)
    try:
        _check(path, level)
        yield str(path)
    finally:
        if is_ours:
            shutil.rmtree(path, ignore_errors=True)


def _check(path: Path, level: Security) -> None:
    try:
        status, made_for = path.stat(), Security(read_regular(path / LEVEL_FILE).decode(errors="replace").strip())
    except (OSError, ValueError) as err:
        reason = getattr(err, "strerror", None) or f"its file {LEVEL_FILE} names no level"
        raise OptionError(f"-o keys={path}: {reason}; give a folder that dds-trace made, or a new name") from err
    if status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise OptionError(f"-o keys={path}: others can read it; chmod 700 it, as your own user")
    if made_for is not level:
        raise OptionError(
            f"-o keys={path}: made for -o security={made_for.value}, not {level.value}; give another folder"
        )


@contextmanager
def shared_keys(levels: Collection[str]) -> Iterator[Sequence[str]]:
    secured = [Security(level) for level in levels if level != Security.OFF.value]
    if not secured:
        yield ()
        return
    for path in Path(tempfile.gettempdir()).glob("dds-trace-keys-*"):  # of a process that was killed
        match = _FOLDER.fullmatch(path.name)
        if match and not Path("/proc", match[1]).exists() and path.stat().st_uid == os.geteuid():
            shutil.rmtree(path, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=f"dds-trace-keys-{os.getpid()}-") as folder:  # mode 0700
        for level in secured:
            make_keys(Path(folder) / level.value, level)
        yield ("env", f"{VARIABLE}={folder}")


def make_keys(path: Path, level: Security) -> None:
    try:
        from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat  # noqa: PLC0415
    except ImportError as err:
        raise BackendUnavailableError(
            f"keys are made by the package cryptography ({err}); pip install 'dds-trace[security]' (in a clone '.[security]')"
        ) from err
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        draft = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))  # mode 0700
    except OSError as err:
        raise OptionError(
            f"-o keys={path}: cannot be made ({err.strerror or err}); give a folder that can be written"
        ) from err
    authority = _Authority()
    signed = {
        "identity_ca.cert.pem": authority.pem,
        "permissions_ca.cert.pem": authority.pem,
        "governance.p7s": authority.sign_text(governance(level)),
    }
    for side in SIDES:
        folder = draft / "enclaves" / side
        folder.mkdir(parents=True)
        certificate, key = authority.issue(f"dds_trace_{side}", authority)
        files = {
            "cert.pem": certificate.public_bytes(Encoding.PEM),
            "key.pem": key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
            "permissions.p7s": authority.sign_text(
                permissions(f"CN=dds_trace_{side}", *(f"{time:%Y-%m-%dT%H:%M:%S}" for time in authority.valid))
            ),
        }
        for name, data in {**signed, **files}.items():
            (folder / name).write_bytes(data)
    (draft / LEVEL_FILE).write_text(level.value)
    with suppress(OSError):  # the other side was faster
        draft.rename(path)
        return
    shutil.rmtree(draft)


class _Authority:
    def __init__(self) -> None:
        now = datetime.now(timezone.utc)
        self.valid = (now - timedelta(days=1), now + _VALID)
        self.certificate, self.key = self.issue("dds_trace_authority", None)

    @property
    def pem(self) -> bytes:
        from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415

        pem: bytes = self.certificate.public_bytes(Encoding.PEM)
        return pem

    def issue(self, name: str, issuer: _Authority | None) -> tuple[Any, Any]:
        from cryptography import x509  # noqa: PLC0415
        from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
        from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        begin, end = self.valid
        builder = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject if issuer is None else issuer.certificate.subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(begin)
            .not_valid_after(end)
            .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
        )
        if issuer is not None:  # TLS of zenoh requires a name
            builder = builder.add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        return builder.sign(key if issuer is None else issuer.key, hashes.SHA256()), key

    def sign_text(self, text: str) -> bytes:
        from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
        from cryptography.hazmat.primitives.serialization import Encoding, pkcs7  # noqa: PLC0415

        options = [pkcs7.PKCS7Options.DetachedSignature, pkcs7.PKCS7Options.Text]
        builder = pkcs7.PKCS7SignatureBuilder().set_data(text.encode())
        return builder.add_signer(self.certificate, self.key, hashes.SHA256()).sign(Encoding.SMIME, options)


def governance(level: Security) -> str:
    kinds = _PROTECTED[level]
    content = f"""<domain_access_rules><domain_rule>
{_DOMAINS}
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>NONE</discovery_protection_kind>
<liveliness_protection_kind>NONE</liveliness_protection_kind>
<rtps_protection_kind>{kinds.get("rtps", "NONE")}</rtps_protection_kind>
<topic_access_rules><topic_rule>
<topic_expression>*</topic_expression>
<enable_discovery_protection>false</enable_discovery_protection>
<enable_liveliness_protection>false</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>NONE</metadata_protection_kind>
<data_protection_kind>{kinds.get("data", "NONE")}</data_protection_kind>
</topic_rule></topic_access_rules>
</domain_rule></domain_access_rules>"""
    return _ROOT.format(schema=_SCHEMAS.format("governance"), content=content)


def permissions(subject: str, not_before: str, not_after: str) -> str:
    everything = "<topics><topic>*</topic></topics><partitions><partition>*</partition></partitions>"
    content = f"""<permissions><grant name="dds_trace">
<subject_name>{subject}</subject_name>
<validity><not_before>{not_before}</not_before><not_after>{not_after}</not_after></validity>
<allow_rule>
{_DOMAINS}
<publish>{everything}</publish>
<subscribe>{everything}</subscribe>
</allow_rule>
<default>DENY</default>
</grant></permissions>"""
    return _ROOT.format(schema=_SCHEMAS.format("permissions"), content=content)
