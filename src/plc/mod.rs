//! The PLC's side: registers, the handshake, the Modbus TCP server.
//! In:  frames from PLCs, reports from the station. Out: orders to the station, registers to PLCs.
//! Not here: how an order is carried out; devices; measuring.

mod exchange;

pub use exchange::{
    Counters, FeatureOutcome, Identity, NotReady, ORDERS, Order, OrderKind, Outcome, PoseOutcome, Report, ResultCode,
    State, Status, Trigger, Verification, Vin,
};
