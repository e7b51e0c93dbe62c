"""Which addresses the server may speak to for somebody else: public ones, and those that the settings list.

A cloud's metadata service answers every program of the machine with its credentials, so it is never meant by a network
that is listed as a whole.
"""

from __future__ import annotations

import ipaddress

from streamlod.core.errors import InputError
from streamlod.core.web_address import address_parts
from streamlod.server.settings import Settings

_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_HOLD_IPV4 = [ipaddress.ip_network(text) for text in (
    "::/96",  # IPv4-compatible
    "::ffff:0:0:0/96",  # translated (RFC 2765)
    "64:ff9b::/96",  # NAT64
    "64:ff9b:1::/48",  # NAT64 of the local network; with the prefix that everybody takes, of 96 bits
)]  # fmt: skip
_PUBLIC_IPV6 = ipaddress.ip_network("2000::/3")  # all that was ever given out
_RESERVED = [ipaddress.ip_network(text) for text in (  # by RFC 6890 and later; not all are known to every Python
    "0.0.0.0/8", "100.64.0.0/10", "169.254.0.0/16", "192.0.0.0/24", "192.0.2.0/24", "192.88.99.0/24", "198.18.0.0/15",
    "198.51.100.0/24", "203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4", "2001::/23", "2001:db8::/32", "3fff::/20",
)]  # fmt: skip
_METADATA = frozenset(ipaddress.ip_address(text) for text in (
    "169.254.169.254",  # most clouds
    "169.254.169.253", "169.254.170.2", "169.254.170.23", "fd00:ec2::254", "fd00:ec2::23",  # AWS
    "fd20:ce::254",  # Google
    "168.63.129.16",  # Azure; it looks like a public one
    "100.100.100.200",  # Alibaba
    "192.0.0.192",  # Oracle
))  # fmt: skip
_METADATA_NAMES = frozenset({"metadata", "metadata.google.internal", "instance-data", "instance-data.ec2.internal"})


def is_reachable(host: str, networks: tuple[str, ...], *, public: bool = True) -> bool:
    """Whether `host` may be spoken to: what `networks` lists, and with `public` any public numeric address.

    A name counts only if it is listed itself, as it may mean another address whenever it is asked for; so does the
    address of a metadata service.
    """
    try:
        address = plain(ipaddress.ip_address(host))
    except ValueError:
        return host in networks
    listed = [ipaddress.ip_network(network) for network in networks if "/" in network]
    if is_metadata(host):
        return any(address in network and network.num_addresses == 1 for network in listed) or host in networks
    return any(address in network for network in listed) or (public and _is_public(address))


def check_places(settings: Settings) -> None:
    """Refuse settings that send the server itself to a metadata service, or to what is no address.

    Raises:
        InputError: they do.
    """
    places = {"jwks": settings.jwks, "trace_endpoint": settings.trace_endpoint}
    places |= {"edge.origin": settings.edge.origin} if settings.edge is not None else {}
    places |= {f"webhooks.{number}": each.url for number, each in enumerate(settings.webhooks)}
    for name, place in places.items():
        host = address_parts(name, place).hostname if place and "://" in place else None
        if host and is_metadata(host) and not is_reachable(host, settings.networks):
            fault = "is a cloud's metadata service, which hands out the machine's credentials; name another address"
            raise InputError(name, f"{host} {fault}")


def is_metadata(host: str) -> bool:
    """Whether a name or numeric address is that of a cloud's metadata service."""
    try:
        return plain(ipaddress.ip_address(host)) in _METADATA
    except ValueError:
        return host.lower().rstrip(".") in _METADATA_NAMES


def plain(address: _Address) -> _Address:
    """The IPv4 address that an IPv6 address stands for, where it does."""
    if isinstance(address, ipaddress.IPv6Address):
        if found := address.ipv4_mapped or address.sixtofour:
            return found
        if any(address in network for network in _HOLD_IPV4):
            return ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return address


def _is_public(address: _Address) -> bool:
    if address.version == 6 and address not in _PUBLIC_IPV6:
        return False
    return address.is_global and not any(address in network for network in _RESERVED)
