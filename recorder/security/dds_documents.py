"""Governance and permissions of DDS Security, as XML (DDS Security 1.1, 9.4)."""

from __future__ import annotations

from ..choices import Security

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


def governance(level: Security) -> str:
    """Return what a domain protects; nobody takes part without a certificate."""
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
