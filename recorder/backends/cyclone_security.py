"""DDS Security of Cyclone DDS: its configuration, and what its process loaded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError

from ..security.dds_documents import LAST_SECURED_DOMAIN
from ..security.keys import enclave

if TYPE_CHECKING:
    from .node import NodeOptions

_LIBRARY = re.compile(r"libdds_security_\w+\.so")

_CONFIGURATION = """<CycloneDDS><Domain><Security>
<Authentication>
<Library initFunction="init_authentication" finalizeFunction="finalize_authentication" path="{1}/libdds_security_auth.so"/>
<IdentityCA>file:{0}/identity_ca.cert.pem</IdentityCA>
<IdentityCertificate>file:{0}/cert.pem</IdentityCertificate>
<PrivateKey>file:{0}/key.pem</PrivateKey>
</Authentication>
<Cryptographic>
<Library initFunction="init_crypto" finalizeFunction="finalize_crypto" path="{1}/libdds_security_crypto.so"/>
</Cryptographic>
<AccessControl>
<Library initFunction="init_access_control" finalizeFunction="finalize_access_control" path="{1}/libdds_security_ac.so"/>
<PermissionsCA>file:{0}/permissions_ca.cert.pem</PermissionsCA>
<Governance>file:{0}/governance.p7s</Governance>
<Permissions>file:{0}/permissions.p7s</Permissions>
</AccessControl>
</Security></Domain></CycloneDDS>"""


def security_settings(options: NodeOptions) -> str:
    """Return the part of CYCLONEDDS_URI, which is in no trace; empty without keys.

    Raises:
        BackendUnavailableError: the loaded Cyclone DDS has no plugins.
    """
    if options.keys is None:
        return ""
    plugins = _plugin_folder()
    if plugins is None:
        raise BackendUnavailableError(
            f"--security {options.security.value}: this Cyclone DDS has no security plugins, as none from pip has; build the package "
            "cyclonedds 0.10.2 against Debian's cyclonedds-dev (docs/how-to/security.md)"
        )
    if options.domain_id > LAST_SECURED_DOMAIN:
        raise OptionError(
            f"--domain {options.domain_id}: secured domains are at most {LAST_SECURED_DOMAIN}; choose another"
        )
    return _CONFIGURATION.format(enclave(options.keys, listens=options.listens), plugins)


def _plugin_folder() -> Path | None:
    """Return the folder of the plugins that belong to the library in this process: next to it, or where Debian has them."""
    library = re.search(r"/\S*libddsc\S*\.so\S*", Path("/proc/self/maps").read_text())
    folder = Path(library[0]).parent if library else Path()
    folders = (folder, folder / "libddsc0debian")
    return next((one for one in folders if (one / "libdds_security_auth.so").exists()), None)


def loaded_plugins() -> str:
    return ", ".join(sorted(set(_LIBRARY.findall(Path("/proc/self/maps").read_text()))))
