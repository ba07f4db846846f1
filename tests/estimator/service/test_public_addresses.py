"""Webhooks reach public addresses only: every range of IANA's registries of special-purpose addresses, at both of its ends."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from typing import Any

import pytest

from estimator.service import post as post_module
from estimator.service.post import Undelivered, check_url, may_reach, post
from estimator.service.problems import Problem

# IANA IPv4 and IPv6 Special-Purpose Address Registries, with multicast and what is deprecated.
SPECIAL = (
    "0.0.0.0/8", "0.0.0.0/32", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16",
    "172.16.0.0/12", "192.0.0.0/24", "192.0.0.0/29", "192.0.0.8/32", "192.0.0.9/32", "192.0.0.10/32",
    "192.0.0.170/32", "192.0.0.171/32", "192.0.0.192/32", "192.0.2.0/24", "192.31.196.0/24",
    "192.52.193.0/24", "192.88.99.0/24", "192.88.99.1/32", "192.168.0.0/16", "192.175.48.0/24",
    "198.18.0.0/15", "198.51.100.0/24", "203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4", "255.255.255.255/32",
    "::/128", "::1/128", "::/96", "::ffff:0:0/96", "::ffff:0:0:0/96", "64:ff9b::/96", "64:ff9b:1::/48",
    "100::/64", "100:0:0:1::/64", "2001::/23", "2001::/32", "2001:1::1/128", "2001:1::2/128", "2001:1::3/128",
    "2001:2::/48", "2001:3::/32", "2001:4:112::/48", "2001:10::/28", "2001:20::/28", "2001:30::/28",
    "2001:db8::/32", "2002::/16", "2620:4f:8000::/48", "3fff::/20", "5f00::/16", "fc00::/7", "fe80::/10",
    "fec0::/10", "ff00::/8",
)  # fmt: skip
PUBLIC = (
    "1.1.1.1", "9.255.255.255", "11.0.0.0", "100.63.255.255", "100.128.0.0", "172.15.255.255", "172.32.0.0",
    "191.255.255.255", "192.0.1.0", "192.0.3.0", "192.31.195.255", "192.88.98.255", "192.88.100.0",
    "192.169.0.0", "198.17.255.255", "198.20.0.0", "223.255.255.255", "2001:200::1", "2001:4860:4860::8888",
    "2606:4700:4700::1111", "2a00:1450:4001::1", "2003::1",
)  # fmt: skip
PRIVATE = ("127.0.0.1", "10.1.2.3", "169.254.169.254", "192.168.1.1")


@pytest.mark.parametrize("network", SPECIAL)
def test_no_address_of_a_special_range_is_public(network):
    spanned = ipaddress.ip_network(network)
    for address in (spanned[0], spanned[-1], spanned[spanned.num_addresses // 2]):
        assert not may_reach(address, ())
        literal = f"[{address}]" if address.version == 6 else str(address)
        with pytest.raises(Problem, match="must not be at a private address"):
            check_url(f"http://{literal}/", ())
        assert may_reach(address, (network,))


@pytest.mark.parametrize("address", PUBLIC)
def test_addresses_beside_them_are_public(address):
    assert may_reach(ipaddress.ip_address(address), ())


@pytest.mark.parametrize("private", PRIVATE)
def test_no_form_of_a_private_address_is_public(private):
    v4 = ipaddress.IPv4Address(private)
    n = int(v4)
    forms = [
        f"::{private}",
        f"::ffff:{private}",
        f"::ffff:0:{private}",
        f"64:ff9b::{private}",
        f"64:ff9b:1::{private}",
    ]
    forms += [str(ipaddress.IPv6Address((0x2002 << 112) | (n << 80))), str(ipaddress.IPv6Address((0x20010000 << 96) | (n ^ 0xFFFFFFFF)))]  # fmt: skip
    for form in forms:
        assert not may_reach(ipaddress.ip_address(form), ()), form
    for literal in (str(n), hex(n), f"0{n:o}", private):
        with pytest.raises(Problem, match="must not be at a private address"):
            check_url(f"http://{literal}/", ())


@pytest.mark.parametrize("address", ["192.0.0.192", "192.88.99.1", "64:ff9b::7f00:1"])
def test_a_name_that_leads_to_one_is_not_followed(monkeypatch, address):
    def looked_up(*_: Any, **__: Any) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 80))]

    monkeypatch.setattr(post_module.socket, "getaddrinfo", looked_up)
    with pytest.raises(Undelivered, match=f"must not be at a private address.* is at {address}"):
        asyncio.run(post("http://alerts.example/", "whsec_AAAA", "1", 1, b"{}", ()))
