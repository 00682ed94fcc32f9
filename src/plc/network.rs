//! Who may connect: networks as "10.1.0.0/16" or one address. In: text. Out: whether an address belongs to it.
//! Not here: sockets.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

/// Addresses with a common beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct Network {
    address: IpAddr,
    /// Leading bits that count.
    bits: u8,
}

/// A text that names no network.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?}, allowed: an address, or an address and a number of bits as in \"10.1.0.0/16\"")]
pub struct NoNetwork(String);

impl Network {
    /// Whether `address` belongs to it. An IPv4 address counts as such however it came.
    pub fn contains(self, address: IpAddr) -> bool {
        let (own, width) = number(self.address);
        let (other, other_width) = number(address.to_canonical());
        let differ = own ^ other;
        width == other_width && (self.bits == 0 || differ >> (width - u32::from(self.bits)) == 0)
    }
}

/// The address as a number, and its bits.
fn number(address: IpAddr) -> (u128, u32) {
    match address {
        IpAddr::V4(a) => (u128::from(a.to_bits()), 32),
        IpAddr::V6(a) => (a.to_bits(), 128),
    }
}

/// This address alone.
impl From<IpAddr> for Network {
    fn from(address: IpAddr) -> Self {
        Self { address, bits: number(address).1 as u8 }
    }
}

impl FromStr for Network {
    type Err = NoNetwork;

    fn from_str(text: &str) -> Result<Self, NoNetwork> {
        let (address, bits) = text.split_once('/').map_or((text, None), |(a, b)| (a, Some(b)));
        let alone = address.parse::<IpAddr>().ok().map(Self::from);
        let network = match bits {
            None => alone,
            Some(b) => alone.zip(b.parse().ok()).map(|(all, bits)| Self { bits, ..all }).filter(|n| {
                let (_, width) = number(n.address);
                u32::from(n.bits) <= width
            }),
        };
        network.ok_or_else(|| NoNetwork(text.into()))
    }
}

impl TryFrom<String> for Network {
    type Error = NoNetwork;

    fn try_from(text: String) -> Result<Self, NoNetwork> {
        text.parse()
    }
}

impl From<Network> for String {
    fn from(network: Network) -> Self {
        network.to_string()
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.address, self.bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_holds_the_addresses_that_begin_like_it() {
        for (network, inside, outside) in [
            ("127.0.0.1", "127.0.0.1", "127.0.0.2"),
            ("10.1.0.0/16", "10.1.255.7", "10.2.0.0"),
            ("10.1.0.0/16", "::ffff:10.1.2.3", "::1"),
            ("0.0.0.0/0", "8.8.8.8", "::1"),
            ("fd00::/8", "fd12::1", "fe80::1"),
        ] {
            let network: Network = network.parse().expect(network);
            let contains = |a: &str| network.contains(a.parse().expect(a));
            assert!(contains(inside) && !contains(outside), "{network}");
        }
    }

    #[test]
    fn what_is_no_network_is_told() {
        for text in ["", "10.1", "10.1.0.0/33", "10.1.0.0/", "plc.local", "::/129"] {
            let said = text.parse::<Network>().expect_err(text).to_string();
            assert!(said.starts_with(&format!("{text:?}, allowed: an address")), "{said}");
        }
    }
}
