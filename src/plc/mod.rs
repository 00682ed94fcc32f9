//! The PLC's side: registers, the handshake, the Modbus TCP server.
//! In:  frames from PLCs, reports from the station. Out: orders to the station, registers to PLCs.
//! Not here: how an order is carried out; devices; measuring.

mod bits;
mod exchange;
mod guard;
mod handshake;
mod network;
mod pages;
mod registers;
mod server;
mod service;
mod shared;
mod snapshot;
mod words;

pub use exchange::{
    Counters, FeatureOutcome, Identity, NotReady, ORDERS, Order, OrderKind, Outcome, PoseOutcome, Pulse, Report,
    ResultCode, State, Status, Trigger, Verification, Vin,
};
pub use network::{Network, NoNetwork};
pub use pages::{csv, function_block, page};
pub use registers::{MAP_MAJOR, MAP_MINOR};
pub use server::{Config, Error, Server};
pub use shared::{CLIENTS, View};
pub use words::WordOrder;
