//! What the server's tasks share: the handshake behind a lock, the newest snapshot, the clients.
//! In:  events from connections, from the supervisor and from the station. Out: orders to the station, snapshots.
//! Not here: sockets.

use super::exchange::{Identity, Order};
use super::handshake::{ClientId, Event, Handshake};
use super::snapshot::{Newest, Snapshot};
use std::net::SocketAddr;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::task::AbortHandle;

/// Connections at a time.
pub const CLIENTS: usize = 8;

/// The writer does not own the command block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotOwner;

/// One connection.
struct Client {
    id: ClientId,
    address: SocketAddr,
    /// When its last frame came, or it connected.
    heard: Instant,
    task: AbortHandle,
}

struct Core {
    handshake: Handshake,
    /// `None`: the server is ending.
    orders: Option<SyncSender<Order>>,
}

pub(super) struct Shared {
    core: Mutex<Core>,
    newest: Newest,
    clients: Mutex<Vec<Client>>,
    identity: Identity,
    began: Instant,
}

/// The PLC's side at one moment, for people.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct View {
    /// Who owns the command block.
    pub owner: Option<SocketAddr>,
    /// Everybody who is connected, the owner too.
    pub clients: Vec<SocketAddr>,
    /// READY.
    pub ready: bool,
    /// RESULT_VALID.
    pub result_valid: bool,
    /// A result waits for its acknowledgement.
    pub waiting: bool,
    /// RESULT_SEQ.
    pub result_seq: u16,
    /// ERROR_CODE.
    pub error: Option<crate::Code>,
    /// How often an owner's heartbeat was lost.
    pub heartbeat_losses: u32,
}

impl Shared {
    pub(super) fn new(handshake: Handshake, orders: SyncSender<Order>) -> Self {
        Self {
            newest: Newest::new(Snapshot::new(&handshake)),
            identity: handshake.identity.clone(),
            core: Mutex::new(Core { handshake, orders: Some(orders) }),
            clients: Mutex::default(),
            began: Instant::now(),
        }
    }

    pub(super) fn newest(&self) -> Arc<Snapshot> {
        self.newest.get()
    }

    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    // A task that panicked is a bug that has been told; the others go on with what it left.
    fn core(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn clients(&self) -> MutexGuard<'_, Vec<Client>> {
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Something happened.
    pub(super) fn step(&self, event: Event) {
        let _ = self.advance(&mut self.core(), event);
    }

    /// A write to the command block.
    pub(super) fn write(&self, client: ClientId, address: u16, words: &[u16]) -> Result<(), NotOwner> {
        self.advance(&mut self.core(), Event::Write { client, address, words })
    }

    /// A change of one register of the command block.
    pub(super) fn modify(
        &self,
        client: ClientId,
        address: u16,
        change: impl FnOnce(u16) -> u16,
    ) -> Result<(), NotOwner> {
        let mut core = self.core();
        let words = &[change(core.handshake.holding[usize::from(address)])];
        self.advance(&mut core, Event::Write { client, address, words })
    }

    /// Steps the handshake, hands its orders on and publishes what the registers now show.
    fn advance(&self, core: &mut Core, event: Event) -> Result<(), NotOwner> {
        let now = self.began.elapsed();
        let before = (core.handshake.owner.map(|o| o.client), core.handshake.error_seq);
        let step = core.handshake.step(now, event);
        if step.not_owner {
            return Err(NotOwner);
        }
        for order in step.orders {
            let Some(orders) = &core.orders else { continue };
            if let Err(full) = orders.try_send(order) {
                let (std::sync::mpsc::TrySendError::Full(order) | std::sync::mpsc::TrySendError::Disconnected(order)) =
                    full;
                tracing::error!(?order, "the station does not take orders");
                core.handshake.step(now, Event::Undelivered(order));
            }
        }
        self.newest.put(Snapshot::new(&core.handshake));
        let h = &core.handshake;
        if h.owner.map(|o| o.client) != before.0 {
            let owner = h.owner.and_then(|o| self.clients().iter().find(|c| c.id == o.client).map(|c| c.address));
            tracing::info!(?owner, "the owner of the command block");
        }
        if let Some((code, detail)) = h.error.filter(|_| h.error_seq != before.1) {
            tracing::warn!(detail, "to the PLC: {code}");
        }
        Ok(())
    }

    /// No more orders: the station ends when it has none left.
    pub(super) fn close(&self) {
        self.core().orders = None;
    }

    /// A connection comes. When there are too many, the longest idle one that is not the owner goes.
    pub(super) fn join(&self, id: ClientId, address: SocketAddr, task: AbortHandle) {
        let owner = self.core().handshake.owner.map(|o| o.client);
        let mut clients = self.clients();
        let others = clients.iter().enumerate().filter(|(_, c)| Some(c.id) != owner);
        let idle = others.min_by_key(|(_, c)| c.heard).map(|(at, _)| at);
        let gone = idle.filter(|_| clients.len() >= CLIENTS).map(|at| clients.remove(at));
        clients.push(Client { id, address, heard: Instant::now(), task });
        drop(clients);
        if let Some(gone) = gone {
            tracing::info!(address = %gone.address, "the longest idle client makes room for {address}");
            gone.task.abort();
        }
    }

    /// A connection is gone.
    pub(super) fn leave(&self, id: ClientId) {
        self.clients().retain(|c| c.id != id);
        self.step(Event::Closed(id));
    }

    /// A frame came.
    pub(super) fn heard(&self, id: ClientId) {
        if let Some(client) = self.clients().iter_mut().find(|c| c.id == id) {
            client.heard = Instant::now();
        }
    }

    #[cfg(test)]
    pub(super) fn panic_under_the_lock(&self) {
        let _core = self.core();
        panic!("planted");
    }

    /// How long ago the server began.
    pub(super) fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    pub(super) fn view(&self) -> View {
        let core = self.core();
        let h = &core.handshake;
        let clients = self.clients();
        View {
            owner: h.owner.and_then(|o| clients.iter().find(|c| c.id == o.client)).map(|c| c.address),
            clients: clients.iter().map(|c| c.address).collect(),
            ready: h.ready(),
            result_valid: h.result_valid(),
            waiting: h.waiting(),
            result_seq: h.result_seq,
            error: h.error.map(|e| e.0),
            heartbeat_losses: h.heartbeat_losses,
        }
    }
}
