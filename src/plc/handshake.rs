//! The handshake with the PLC as a pure state machine.
//! In:  the time and one event: a client's write, a closed connection, a report of the station, a tick.
//! Out: orders to the station; its fields are what the registers show.
//! Not here: clock, sockets, threads (the server); addresses and invalid values of the status registers (the table).
//!
//! A command bit counts when it is seen to rise: at 0 it is armed, at 1 it is taken, once. So a bit that was at 1
//! when its connection became the owner counts for nothing until it has been at 0. Within one write the parameters
//! come first, then RESULT_ACK, then the command.

use super::WordOrder;
use super::bits::{COMMANDS, control, not_ready, status, when};
use super::exchange::{Identity, Order, OrderKind, Outcome, Report, ResultCode, State, Status, Trigger, Vin};
use super::registers::{
    COLOUR, CONTROL, HOLDING, JOB_REQ, MODEL_CODE, OPTIONS, PLC_HEARTBEAT, RESERVED, TRIGGER_ID, VIN,
};
use super::words;
use crate::code::Code;
use std::time::Duration;

/// A command bit must drop this long after its command was answered.
const DROP: Duration = Duration::from_secs(10);
/// A result should be acknowledged in this time.
const ACKNOWLEDGE: Duration = Duration::from_secs(10);
/// The bit of OPTIONS that is not reserved.
const KEEP_IMAGES: u16 = 1 << 3;

/// How the handshake is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Settings {
    /// PLC_HEARTBEAT must change within this time.
    pub(super) heartbeat_timeout: Duration,
    /// Vehicles trigger by themselves: `trigger = "presence"`. Cycles that the station began by itself then need an
    /// acknowledgement like any other.
    pub(super) presence: bool,
    /// Of 32- and 64-bit values.
    pub(super) word_order: WordOrder,
}

/// A connection; never given twice.
pub(super) type ClientId = u64;

/// What happens to the handshake.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Event<'a> {
    /// A client wrote holding registers; the span lies within 0 to 63.
    Write { client: ClientId, address: u16, words: &'a [u16] },
    /// A connection is gone.
    Closed(ClientId),
    /// The station tells something.
    Report(Report),
    /// An order did not reach the station: its queue is full.
    Undelivered(Order),
    /// The supervisor has seen the station alive.
    Beat,
    /// Time has passed.
    Tick,
}

/// What came of an event.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Step {
    /// For the station, in this order.
    pub(super) orders: Vec<Order>,
    /// The writer does not own the command block: nothing was written.
    pub(super) not_owner: bool,
}

/// Who owns the command block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) client: ClientId,
    /// When PLC_HEARTBEAT last changed, or the ownership began.
    heartbeat_at: Duration,
    /// It has changed.
    alive: bool,
}

/// An owner that lost the command block by its heartbeat. Were it to own again by merely repeating its outputs, a
/// stopped PLC would keep the block from others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Lost {
    client: ClientId,
    /// PLC_HEARTBEAT as it stood.
    heartbeat: u16,
    /// It has since written another one, or ENABLE = 0.
    revived: bool,
}

/// A measurement under way.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Cycle {
    id: u32,
    /// The last image is there.
    acquired: bool,
    /// The result is for an owner who acknowledges it.
    owned: bool,
    /// The result is not shown: the one before had not been acknowledged.
    unwanted: bool,
    /// The station is at a cycle of its own; this one comes after it.
    queued: bool,
}

/// A result, or its place while there is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Shown {
    pub(super) id: u32,
    pub(super) vin: Vin,
    pub(super) outcome: Option<Outcome>,
    /// As it was when the result came: the block is frozen.
    pub(super) verified_ago: Option<Duration>,
}

/// Whether the result shown counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Validity {
    /// There is none, or it was acknowledged.
    None,
    /// Anybody may read it, nobody needs to acknowledge it.
    Readable,
    /// It waits for the owner, since then.
    Waiting { since: Duration, late: bool },
}

/// CMD_DONE or CMD_REJECTED.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Answer {
    done: bool,
    /// The command bits it answers: it falls when they have. 0: they fell before the answer came, or there were none;
    /// then it stays until the next command or RESULT_ACK, so that a slow PLC sees it.
    bits: u16,
}

/// See the head of this file.
pub(super) struct Handshake {
    pub(super) config: Settings,
    pub(super) identity: Identity,
    /// The command block, as the owner wrote it.
    pub(super) holding: [u16; HOLDING as usize],
    /// Command bits that have been seen at 0.
    armed: u16,
    pub(super) owner: Option<Owner>,
    lost: Option<Lost>,
    cycle: Option<Cycle>,
    /// Orders other than measuring that the station is at.
    working: Vec<OrderKind>,
    trigger_ack: bool,
    answer: Option<Answer>,
    /// Since when a command bit is to be dropped, and whether its time-out has been told.
    to_drop: Option<(Duration, bool)>,
    may_move: bool,
    pub(super) shown: Shown,
    validity: Validity,
    /// Id of the last acknowledged result; 0: none.
    acknowledged: u32,
    pub(super) result_seq: u16,
    /// Latched until CLEAR_ERROR.
    latched: Option<(Code, u16)>,
    /// The last error that the station told, as the reason of a fault.
    fault: Option<(Code, u16)>,
    /// ERROR_CODE and ERROR_DETAIL.
    pub(super) error: Option<(Code, u16)>,
    pub(super) error_seq: u32,
    pub(super) heartbeat: u16,
    pub(super) status: Status,
    pub(super) rejected_triggers: u32,
    pub(super) heartbeat_losses: u32,
    /// The stand-by that the station was told.
    standing_by: bool,
    /// What the station was last told of whether there is an owner.
    told_owned: bool,
    orders: Vec<Order>,
}

impl Handshake {
    /// As after boot: no owner, nothing armed, no result.
    pub(super) fn new(config: Settings, identity: Identity) -> Self {
        Self {
            config,
            identity,
            holding: [0; HOLDING as usize],
            armed: 0,
            owner: None,
            lost: None,
            cycle: None,
            working: Vec::new(),
            trigger_ack: false,
            answer: None,
            to_drop: None,
            may_move: false,
            shown: Shown::default(),
            validity: Validity::None,
            acknowledged: 0,
            result_seq: 0,
            latched: None,
            fault: None,
            error: None,
            error_seq: 0,
            heartbeat: 0,
            status: Status::default(),
            rejected_triggers: 0,
            heartbeat_losses: 0,
            standing_by: false,
            told_owned: false,
            orders: Vec::new(),
        }
    }

    /// Takes one event. `now` never goes back.
    pub(super) fn step(&mut self, now: Duration, event: Event) -> Step {
        let mut not_owner = false;
        let undelivered = matches!(event, Event::Undelivered(_)); // tried again with the next event
        match event {
            Event::Write { client, address, words } => not_owner = !self.write(now, client, address, words),
            Event::Closed(client) => {
                if self.is_owner(client) {
                    self.release();
                }
            }
            Event::Report(report) => self.report(now, report),
            Event::Undelivered(order) => self.undelivered(now, &order),
            Event::Beat => self.heartbeat = self.heartbeat.wrapping_add(1),
            Event::Tick => self.tick(now),
        }
        if self.owner.is_some() != self.told_owned && !undelivered {
            self.told_owned = self.owner.is_some();
            self.orders.push(Order::Own(self.told_owned));
        }
        let stand_by = self.commanded(control::STANDBY);
        if stand_by != self.standing_by && !undelivered {
            self.standing_by = stand_by;
            self.orders.push(Order::StandBy(stand_by));
        }
        // falls when READY returns: nobody has to look for its edge
        self.may_move &= self.cycle.is_some() || self.result_valid() || self.commanded(control::RESULT_ACK);
        Step { orders: std::mem::take(&mut self.orders), not_owner }
    }

    // The owner's writes

    fn is_owner(&self, client: ClientId) -> bool {
        self.owner.is_some_and(|o| o.client == client)
    }

    /// Whether these bits of CONTROL are set.
    fn commanded(&self, bits: u16) -> bool {
        self.holding[usize::from(CONTROL)] & bits != 0
    }

    /// TRIGGER_ID as written.
    pub(super) fn trigger_id(&self) -> u32 {
        let at = usize::from(TRIGGER_ID);
        self.config.word_order.u32([self.holding[at], self.holding[at + 1]])
    }

    /// The VIN as written.
    pub(super) fn vin(&self) -> Vin {
        words::text(&self.holding[usize::from(VIN)..usize::from(RESERVED)])
    }

    /// False: the writer is not the owner, and did not become it.
    fn write(&mut self, now: Duration, client: ClientId, address: u16, words: &[u16]) -> bool {
        let mut holding = self.holding;
        let start = usize::from(address);
        holding[start..start + words.len()].copy_from_slice(words);
        let [control, heartbeat] = [CONTROL, PLC_HEARTBEAT].map(|a| holding[usize::from(a)]);
        let writes_control = address == CONTROL;
        let takes = self.owner.is_none() && writes_control && control & control::ENABLE != 0;
        if let Some(lost) = self.lost.as_mut().filter(|l| l.client == client) {
            let writes_heartbeat = (address..).zip(words).any(|(a, _)| a == PLC_HEARTBEAT);
            lost.revived |= writes_heartbeat && heartbeat != lost.heartbeat;
            lost.revived |= writes_control && control & control::ENABLE == 0;
            if takes && !lost.revived {
                return false;
            }
        }
        if !self.is_owner(client) && !takes {
            return false;
        }
        let [options, colour] = [OPTIONS, COLOUR].map(|a| holding[usize::from(a)]);
        let reserved = (control & 0xFF00) | colour | (options & !KEEP_IMAGES);
        if reserved != 0 || holding[usize::from(RESERVED)..].iter().any(|w| *w != 0) {
            self.refuse(now, Code::ReservedBits, 0, 0);
            return true;
        }
        if takes {
            self.take(now, client);
        }
        if let Some(owner) = self.owner.as_mut().filter(|_| heartbeat != self.holding[usize::from(PLC_HEARTBEAT)]) {
            *owner = Owner { client, heartbeat_at: now, alive: true };
        }
        self.holding = holding;
        if control & control::ENABLE == 0 {
            self.release();
        } else if writes_control {
            self.control(now, control);
        }
        true
    }

    /// A connection becomes the owner: nothing is armed, and results that were for nobody are withdrawn.
    fn take(&mut self, now: Duration, client: ClientId) {
        self.owner = Some(Owner { client, heartbeat_at: now, alive: false });
        self.lost = None;
        self.armed = 0;
        if self.validity == Validity::Readable {
            self.validity = Validity::None;
            self.shown = Shown::default();
        }
    }

    /// The command block is nobody's; what the station is at goes on.
    fn release(&mut self) {
        self.owner = None;
        self.holding[usize::from(CONTROL)] = 0;
        self.trigger_ack = false;
        self.answer = None;
        self.to_drop = None;
    }

    fn control(&mut self, now: Duration, control: u16) {
        self.armed |= !control;
        let risen = control & self.armed;
        self.armed &= !risen;
        self.trigger_ack &= control & control::TRIGGER != 0;
        self.answer = self.answer.filter(|a| a.bits == 0 || control & a.bits != 0);
        if control & COMMANDS == 0 {
            self.to_drop = None;
        }
        if risen & control::RESULT_ACK != 0 {
            self.acknowledge();
        }
        let command = risen & COMMANDS;
        if command != 0 {
            self.answer = None;
        }
        match command {
            0 => {}
            _ if (control & COMMANDS).count_ones() > 1 => self.refuse(now, Code::TwoCommands, 0, control & COMMANDS),
            control::TRIGGER => self.trigger(now),
            control::JOB_LOAD => self.load_job(now),
            control::CLEAR_ERROR => self.clear_error(now),
            control::VERIFY => self.verify(now),
            _ => self.abort(now),
        }
    }

    fn acknowledge(&mut self) {
        if self.waiting() {
            self.validity = Validity::None;
            self.acknowledged = self.shown.id;
        }
        self.answer = self.answer.filter(|a| a.bits != 0);
    }

    fn trigger(&mut self, now: Duration) {
        let id = self.trigger_id();
        let running = self.cycle.as_ref().is_some_and(|c| c.id == id && !c.unwanted);
        if id != 0 && (running || self.waiting() && self.shown.id == id) {
            return self.accept_trigger(now); // the reply was lost, or the PLC started anew: one vehicle, one result
        }
        let job = self.holding[usize::from(JOB_REQ)];
        let refusal = if let Some(fault) = self.in_fault() {
            Some(fault)
        } else if id == 0 {
            Some((Code::TriggerId, 0))
        } else if self.busy() {
            Some((Code::TriggerWhileBusy, 0))
        } else if self.waiting() || self.commanded(control::RESULT_ACK) {
            Some((Code::TriggerWhileAckPending, 0))
        } else if id == self.acknowledged {
            Some((Code::TriggerId, 0))
        } else if let Some(code) = self.unfit().or_else(|| lacking(&self.status, job)) {
            Some((code, 0))
        } else if self.status.presence_fitted && !self.status.vehicle_present {
            Some((Code::NoVehicle, 0))
        } else {
            (job > 999).then_some((Code::UnknownJob, job))
        };
        if let Some((code, detail)) = refusal {
            return self.refuse(now, code, detail, control::TRIGGER);
        }
        let trigger = Trigger {
            id,
            job,
            model_code: self.holding[usize::from(MODEL_CODE)],
            vin: self.vin(),
            keep_images: self.holding[usize::from(OPTIONS)] & KEEP_IMAGES != 0,
        };
        self.begin(&trigger, true);
        self.orders.push(Order::Measure(trigger));
        self.accept_trigger(now);
    }

    fn accept_trigger(&mut self, now: Duration) {
        self.trigger_ack = true;
        self.to_drop = Some((now, false));
    }

    fn load_job(&mut self, now: Duration) {
        let job = self.holding[usize::from(JOB_REQ)];
        let refusal = if self.busy() {
            Some(Code::JobWhileBusy)
        } else if self.waiting() {
            Some(Code::TriggerWhileAckPending)
        } else {
            (!(1..=999).contains(&job)).then_some(Code::UnknownJob)
        };
        match refusal {
            Some(code) => self.refuse(now, code, 0, control::JOB_LOAD),
            None => {
                let model_code = self.holding[usize::from(MODEL_CODE)];
                self.order(OrderKind::LoadJob, Order::LoadJob { job, model_code });
            }
        }
    }

    fn clear_error(&mut self, now: Duration) {
        self.latched = None;
        self.error = None;
        // the station has only a fault to forget; while it is at something it would answer too late
        if self.in_fault().is_some() && !self.busy() {
            self.order(OrderKind::ClearError, Order::ClearError);
        } else {
            self.done(now, control::CLEAR_ERROR);
        }
    }

    fn verify(&mut self, now: Duration) {
        let refusal = if let Some(fault) = self.in_fault() {
            Some(fault)
        } else if self.busy() {
            Some((Code::TriggerWhileBusy, 0))
        } else if self.waiting() {
            Some((Code::TriggerWhileAckPending, 0))
        } else {
            self.unfit().map(|code| (code, 0))
        };
        match refusal {
            Some((code, detail)) => self.refuse(now, code, detail, control::VERIFY),
            None => self.order(OrderKind::Verify, Order::Verify),
        }
    }

    fn abort(&mut self, now: Duration) {
        if self.working.contains(&OrderKind::Abort) {
            self.refuse(now, Code::TriggerWhileBusy, 0, control::ABORT);
        } else if self.busy() {
            self.order(OrderKind::Abort, Order::Abort);
        } else {
            self.done(now, control::ABORT);
        }
    }

    fn order(&mut self, kind: OrderKind, order: Order) {
        self.working.push(kind);
        self.orders.push(order);
    }

    /// Answers a command: it was carried out.
    fn done(&mut self, now: Duration, bit: u16) {
        self.reply(now, true, bit);
    }

    /// Answers a command, or a write that was none: refused, and why.
    fn refuse(&mut self, now: Duration, code: Code, detail: u16, bits: u16) {
        self.rejected_triggers += u32::from(bits & control::TRIGGER != 0);
        self.tell(code, detail);
        self.reply(now, false, bits);
    }

    fn reply(&mut self, now: Duration, done: bool, bits: u16) {
        let bits = bits & self.holding[usize::from(CONTROL)];
        self.answer = Some(Answer { done, bits });
        if bits != 0 {
            self.to_drop = Some((now, false));
        }
    }

    /// Shows a code; it stands until another, a new cycle or CLEAR_ERROR.
    fn tell(&mut self, code: Code, detail: u16) {
        self.error = Some((code, detail));
        self.error_seq = self.error_seq.wrapping_add(1);
    }

    /// Shows a code and latches ERROR.
    fn latch(&mut self, code: Code, detail: u16) {
        self.latched = Some((code, detail));
        self.tell(code, detail);
    }

    // The station's reports

    fn report(&mut self, now: Duration, report: Report) {
        match report {
            Report::Status(status) => {
                if let Some(code) = status.warning.filter(|code| self.status.warning != Some(*code)) {
                    self.tell(code, 0);
                }
                self.status = *status;
            }
            Report::Began(trigger) => self.began(&trigger),
            Report::Acquired => {
                if let Some(cycle) = self.cycle.as_mut().filter(|c| !c.queued) {
                    cycle.acquired = true;
                    self.may_move = true;
                }
            }
            Report::Finished(outcome) => self.finished(now, *outcome),
            Report::Done(kind) => {
                if self.ends(kind) {
                    self.done(now, bit_of(kind));
                }
            }
            Report::Refused { order: OrderKind::Measure, code, detail } => {
                if self.cycle.take_if(|c| c.id != 0).is_some() {
                    self.trigger_ack = false;
                    self.refuse(now, code, detail, control::TRIGGER);
                }
            }
            Report::Refused { order, code, detail } => {
                if self.ends(order) {
                    self.refuse(now, code, detail, bit_of(order));
                }
            }
            Report::Error(code, detail) => {
                self.fault = Some((code, detail));
                self.latch(code, detail);
            }
        }
    }

    /// Whether the station was at this order; now it no longer is.
    fn ends(&mut self, kind: OrderKind) -> bool {
        let found = self.working.iter().position(|k| *k == kind);
        found.map(|at| self.working.remove(at)).is_some()
    }

    /// Never a stale pose: the echo is the new vehicle's, everything else unknown.
    fn begin(&mut self, trigger: &Trigger, owned: bool) {
        self.cycle = Some(Cycle { id: trigger.id, acquired: false, owned, unwanted: false, queued: false });
        self.shown = Shown { id: trigger.id, vin: trigger.vin.clone(), ..Shown::default() };
        self.validity = Validity::None;
        self.may_move = false;
        self.error = self.latched;
    }

    /// The station began a cycle by itself.
    fn began(&mut self, trigger: &Trigger) {
        if let Some(cycle) = &mut self.cycle {
            cycle.queued = cycle.id != trigger.id; // both began at once: the trigger's turn comes after this one
        } else if self.waiting() {
            // the vehicle is recorded as aborted; the result that waits is not lost
            self.cycle = Some(Cycle { id: trigger.id, acquired: false, owned: false, unwanted: true, queued: false });
            self.orders.push(Order::Abort);
            self.rejected_triggers += 1;
            self.tell(Code::TriggerWhileAckPending, 0);
        } else {
            self.begin(trigger, self.config.presence && self.owner.is_some());
        }
    }

    fn finished(&mut self, now: Duration, outcome: Outcome) {
        let Some(cycle) = self.cycle.take_if(|c| c.id == outcome.trigger.id) else {
            if let Some(cycle) = &mut self.cycle {
                cycle.queued = false;
            }
            return;
        };
        // a cycle that was for nobody, and now there is an owner: not his vehicle
        let owned = cycle.owned || self.config.presence && self.owner.is_some();
        if cycle.unwanted || !owned && self.owner.is_some() {
            return;
        }
        self.validity = if owned { Validity::Waiting { since: now, late: false } } else { Validity::Readable };
        self.may_move = true;
        self.result_seq = self.result_seq.checked_add(1).unwrap_or(1);
        if let Some(code) = outcome.code {
            self.tell(code, outcome.detail);
        }
        let (id, vin) = (outcome.trigger.id, outcome.trigger.vin.clone());
        self.shown = Shown { id, vin, outcome: Some(outcome), verified_ago: self.status.verified_ago };
    }

    fn undelivered(&mut self, now: Duration, order: &Order) {
        let order = match order {
            Order::Measure(_) => OrderKind::Measure,
            Order::LoadJob { .. } => OrderKind::LoadJob,
            Order::Verify => OrderKind::Verify,
            Order::Abort => OrderKind::Abort,
            Order::ClearError => OrderKind::ClearError,
            Order::StandBy(told) => {
                self.standing_by = !told;
                return;
            }
            Order::Own(told) => {
                self.told_owned = !told;
                return;
            }
        };
        self.report(now, Report::Refused { order, code: Code::TriggerWhileBusy, detail: 0 });
    }

    // Time

    fn tick(&mut self, now: Duration) {
        let since = |then: Duration| now.saturating_sub(then);
        if let Some((_, late)) = self.to_drop.as_mut().filter(|(then, late)| !late && since(*then) >= DROP) {
            *late = true;
            self.latch(Code::CommandNotDropped, 0);
        }
        if let Validity::Waiting { since: then, late: late @ false } = &mut self.validity
            && since(*then) >= ACKNOWLEDGE
        {
            *late = true;
            self.tell(Code::AckTimeout, 0);
        }
        let timeout = self.config.heartbeat_timeout;
        if let Some(owner) = self.owner.filter(|o| since(o.heartbeat_at) >= timeout) {
            let heartbeat = self.holding[usize::from(PLC_HEARTBEAT)];
            self.lost = Some(Lost { client: owner.client, heartbeat, revived: false });
            self.heartbeat_losses += 1;
            self.latch(Code::HeartbeatLost, 0);
            self.release();
        }
    }

    // What the registers show

    /// A result waits for its acknowledgement.
    pub(super) fn waiting(&self) -> bool {
        matches!(self.validity, Validity::Waiting { .. })
    }

    /// RESULT_VALID.
    pub(super) fn result_valid(&self) -> bool {
        self.validity != Validity::None
    }

    fn busy(&self) -> bool {
        self.cycle.is_some() || !self.working.is_empty()
    }

    /// READY.
    pub(super) fn ready(&self) -> bool {
        self.status.state == State::Ready && self.not_ready_reason() == 0 && !self.busy()
    }

    /// The fault's code, if there is a fault.
    fn in_fault(&self) -> Option<(Code, u16)> {
        let code = || self.fault.or(lacking(&self.status, 0).map(|c| (c, 0))).unwrap_or((Code::TriggerInService, 0));
        (self.status.state == State::Fault).then(code)
    }

    /// Why the station's state does not allow a measurement.
    fn unfit(&self) -> Option<Code> {
        match self.status.state {
            _ if self.standing_by || self.commanded(control::STANDBY) => Some(Code::TriggerInService),
            State::Boot | State::SelfTest | State::WarmUp => Some(Code::TriggerInWarmUp),
            State::Service | State::Updating | State::Fault => Some(Code::TriggerInService),
            State::Acquiring | State::Processing | State::JobLoad | State::Verify => Some(Code::TriggerWhileBusy),
            State::Ready | State::WaitAck => None,
        }
    }

    /// The register STATUS.
    pub(super) fn status_bits(&self) -> u16 {
        let s = &self.status;
        let passed = self.shown.outcome.as_ref().is_some_and(|o| o.result == ResultCode::Ok);
        let late = matches!(self.validity, Validity::Waiting { late: true, .. });
        when(self.ready(), status::READY)
            | when(self.trigger_ack, status::TRIGGER_ACK)
            | when(self.busy(), status::BUSY)
            | when(self.may_move, status::ACQ_DONE)
            | when(self.result_valid(), status::RESULT_VALID)
            | when(self.result_valid() && passed, status::PASS)
            | when(self.answer.is_some_and(|a| a.done), status::CMD_DONE)
            | when(self.answer.is_some_and(|a| !a.done), status::CMD_REJECTED)
            | when(self.latched.is_some(), status::ERROR)
            | when(s.warning.is_some() || late, status::WARNING)
            | when(self.owner.is_some(), status::OWNER_OK)
            | when(s.calibration_valid, status::CAL_VALID)
            | when(s.warm, status::WARM)
            | when(self.owner.is_some_and(|o| o.alive), status::PLC_HB_OK)
            | when(s.verify_due, status::VERIFY_DUE)
            | when(s.simulated, status::SIMULATED)
    }

    /// The register STATE.
    pub(super) fn state(&self) -> State {
        let acquired = self.cycle.as_ref().map(|c| c.acquired);
        match (acquired, self.status.state) {
            (Some(false), _) => State::Acquiring,
            (Some(true), _) => State::Processing,
            _ if self.working.contains(&OrderKind::LoadJob) => State::JobLoad,
            _ if self.working.contains(&OrderKind::Verify) => State::Verify,
            (None, State::Ready | State::Acquiring | State::Processing) if self.waiting() => State::WaitAck,
            (None, state) => state,
        }
    }

    /// The register NOT_READY_REASON.
    pub(super) fn not_ready_reason(&self) -> u16 {
        let n = self.status.not_ready;
        let pending = self.waiting() || self.commanded(control::RESULT_ACK);
        when(n.not_warm, not_ready::NOT_WARM)
            | when(n.calibration, not_ready::CALIBRATION)
            | when(n.no_job, not_ready::NO_JOB)
            | when(n.camera, not_ready::CAMERA)
            | when(n.projector, not_ready::PROJECTOR)
            | when(n.light, not_ready::LIGHT)
            | when(n.service || self.commanded(control::STANDBY), not_ready::SERVICE)
            | when(self.lost.is_some() && (self.busy() || self.waiting()), not_ready::PLC_HEARTBEAT)
            | when(pending, not_ready::ACK_PENDING)
            | when(n.storage, not_ready::STORAGE)
            | when(n.temperature, not_ready::TEMPERATURE)
            | when(n.clock, not_ready::CLOCK)
    }
}

/// The command bit of an order.
fn bit_of(kind: OrderKind) -> u16 {
    match kind {
        OrderKind::Measure => control::TRIGGER,
        OrderKind::LoadJob => control::JOB_LOAD,
        OrderKind::Verify => control::VERIFY,
        OrderKind::Abort => control::ABORT,
        OrderKind::ClearError => control::CLEAR_ERROR,
    }
}

/// The code of the first thing that the station lacks for measuring this job; 0: the active one.
fn lacking(status: &Status, job: u16) -> Option<Code> {
    let n = status.not_ready;
    let table = [
        (n.not_warm, Code::TriggerInWarmUp),
        (n.calibration, Code::CalibrationExpired),
        (n.no_job && job == 0, Code::UnknownJob),
        (n.camera, Code::CameraLost),
        (n.projector, Code::ProjectorSilent),
        (n.light, Code::LightFault),
        (n.service, Code::TriggerInService),
        (n.storage, Code::StorageFault),
        (n.temperature, Code::OverTemperature),
        (n.clock, Code::ClockNotSet),
    ];
    table.into_iter().find(|(lacks, _)| *lacks).map(|(_, code)| code)
}

#[cfg(test)]
#[path = "handshake_tests.rs"]
mod tests;
#[cfg(test)]
pub(super) use tests::good;
