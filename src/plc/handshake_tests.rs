//! The handshake over a station that is a plain function: each numbered decision of the contract, each cell of its table
//! of states and events.

use super::*;
use crate::plc::exchange::{FeatureOutcome, NotReady, PoseOutcome};
use crate::plc::snapshot::Snapshot;

/// The PLC, and another client.
const PLC: ClientId = 1;
const OTHER: ClientId = 2;
const SECOND: Duration = Duration::from_secs(1);

use control::{ABORT, CLEAR_ERROR, ENABLE, JOB_LOAD, RESULT_ACK, STANDBY, TRIGGER, VERIFY};

/// A handshake, its time, and the orders that the station has not looked at.
struct Bench {
    h: Handshake,
    now: Duration,
    orders: Vec<Order>,
}

fn ready_status() -> Status {
    Status { state: State::Ready, calibration_valid: true, warm: true, active_job: 7, ..Status::default() }
}

/// What a good measurement says.
pub(in crate::plc) fn good(trigger: &Trigger) -> Outcome {
    let feature = |x: f64| FeatureOutcome {
        code: None,
        position_mm: Some([x, -2.0, 3.5]),
        residual_mm: Some(0.05),
        score: Some(0.9),
    };
    Outcome {
        result: ResultCode::Ok,
        code: None,
        detail: 0,
        trigger: trigger.clone(),
        job: 7,
        pose: Some(PoseOutcome {
            position_mm: [1.0, -2.5, 1000.001],
            angles_deg: [0.1, -0.2, 0.000_003],
            u_position_mm: [0.05, 0.06, 70.0],
            u_angles_deg: [0.01, 0.02, 0.03],
            u_target_mm: None,
            residual_rms_mm: 0.04,
        }),
        features: [Some(feature(1.0)), Some(feature(10.0)), Some(feature(100.0)), None],
        distance_deviation_mm: Some(0.1),
        surface_vs_point_mm: None,
        depth_coverage: Some(0.987),
        calibration_health_px: Some(0.033),
        light: Some([0.5, 0.6]),
        ambient: Some(12.3),
        camera_celsius: Some(31.26),
        projector_celsius: Some(-4.0),
        acquisition: Some(Duration::from_millis(900)),
        total: Some(Duration::from_millis(1400)),
        taken_at_ms: 0x0000_0193_5A5A_1234,
        record: 42,
    }
}

/// The station: what it reports when it carries out an order.
fn station(order: &Order) -> Vec<Report> {
    match order {
        Order::Measure(trigger) => vec![Report::Acquired, Report::Finished(Box::new(good(trigger)))],
        Order::LoadJob { .. } => vec![Report::Done(OrderKind::LoadJob)],
        Order::Verify => vec![Report::Done(OrderKind::Verify)],
        Order::Abort => vec![Report::Done(OrderKind::Abort)],
        Order::ClearError => vec![Report::Done(OrderKind::ClearError)],
        Order::StandBy(_) | Order::Own(_) => vec![],
    }
}

impl Bench {
    /// After boot, with a station that is ready.
    fn new(presence: bool) -> Self {
        let heartbeat_timeout = 3 * SECOND;
        let settings = Settings { heartbeat_timeout, presence, word_order: WordOrder::HighFirst };
        let h = Handshake::new(settings, Identity::default());
        let mut bench = Self { h, now: SECOND, orders: Vec::new() };
        bench.status(ready_status());
        bench
    }

    /// And the PLC owns the command block.
    fn owned() -> Self {
        let mut bench = Self::new(false);
        assert!(bench.control(ENABLE));
        bench
    }

    /// A measurement of vehicle 5 is under way.
    fn busy() -> Self {
        let mut bench = Self::owned();
        bench.trigger(5);
        bench.control(ENABLE);
        bench.expect(status::BUSY, status::READY | status::TRIGGER_ACK | status::RESULT_VALID);
        bench
    }

    /// The result of vehicle 5 waits.
    fn waiting() -> Self {
        let mut bench = Self::busy();
        bench.carry_out();
        bench.expect(status::RESULT_VALID | status::PASS, status::BUSY | status::READY);
        bench
    }

    /// The camera is lost.
    fn fault() -> Self {
        let mut bench = Self::owned();
        bench.report(Report::Error(Code::CameraLost, 3));
        bench.status(Status { state: State::Fault, ..ready_status() });
        bench.expect(status::ERROR, status::READY);
        bench
    }

    fn step(&mut self, event: Event) -> bool {
        let step = self.h.step(self.now, event);
        // who owns is told beside what is ordered: a test of its own
        self.orders.extend(step.orders.into_iter().filter(|o| !matches!(o, Order::Own(_))));
        !step.not_owner
    }

    fn write(&mut self, client: ClientId, address: u16, words: &[u16]) -> bool {
        self.step(Event::Write { client, address, words })
    }

    fn control(&mut self, control: u16) -> bool {
        self.write(PLC, CONTROL, &[control])
    }

    /// One write of all parameters with TRIGGER.
    fn trigger(&mut self, id: u32) {
        let mut words = [0; 17];
        words[0] = ENABLE | TRIGGER;
        words[1] = self.h.holding[1];
        (words[2], words[3]) = ((id >> 16) as u16, id as u16);
        words[8..].copy_from_slice(&words::of_text("WBA00000000000005", 9));
        assert!(self.write(PLC, 0, &words));
    }

    fn report(&mut self, report: Report) {
        self.step(Event::Report(report));
    }

    fn status(&mut self, status: Status) {
        self.report(Report::Status(Box::new(status)));
    }

    /// The station carries out what it was told.
    fn carry_out(&mut self) {
        for order in std::mem::take(&mut self.orders) {
            station(&order).into_iter().for_each(|r| self.report(r));
        }
    }

    /// Time passes; the PLC's heart beats.
    fn pass(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = end.min(self.now + SECOND / 10);
            if self.h.owner.is_some() {
                let beat = self.h.holding[1].wrapping_add(1);
                self.write(PLC, PLC_HEARTBEAT, &[beat]);
            }
            self.step(Event::Tick);
        }
    }

    #[track_caller]
    fn expect(&self, set: u16, clear: u16) {
        let bits = self.h.status_bits();
        assert!(bits & set == set && bits & clear == 0, "{bits:016b}, expected {set:016b} and not {clear:016b}");
    }

    /// The command was refused with this code, nothing was ordered, and CMD_REJECTED falls with the bit.
    #[track_caller]
    fn expect_refused(&mut self, code: u16) {
        self.expect(status::CMD_REJECTED, status::TRIGGER_ACK | status::CMD_DONE);
        assert_eq!((self.input(4, 1)[0], &self.orders[..]), (code, &[][..]));
        self.control(ENABLE);
        self.expect(0, status::CMD_REJECTED);
    }

    /// The command was carried out, and CMD_DONE falls with the bit.
    #[track_caller]
    fn expect_done(&mut self) {
        self.expect(status::CMD_DONE, status::CMD_REJECTED | status::BUSY);
        self.control(ENABLE);
        self.expect(0, status::CMD_DONE);
    }

    fn input(&self, address: u16, quantity: u16) -> Vec<u16> {
        Snapshot::new(&self.h).input(address, quantity).expect("registers of the table").to_vec()
    }

    /// RESULT_CODE, and whether X is there.
    fn result(&self) -> (u16, bool) {
        (self.input(15, 1)[0], self.input(17, 2) != [0x8000, 0])
    }
}

// The table: TRIGGER, new id

#[test]
fn trigger_with_a_new_id_when_ready_is_acknowledged_and_starts() {
    let mut b = Bench::owned();
    b.expect(status::READY, 0);
    b.trigger(5);
    b.expect(status::TRIGGER_ACK | status::BUSY, status::READY | status::CMD_REJECTED);
    let [Order::Measure(t)] = &b.orders[..] else { panic!("{:?}", b.orders) };
    assert_eq!((t.id, t.job, t.vin.as_str(), t.keep_images), (5, 0, "WBA00000000000005", false));
    assert_eq!(b.h.state(), State::Acquiring);
    b.control(ENABLE);
    b.expect(status::BUSY, status::TRIGGER_ACK);
}

#[test]
fn trigger_with_a_new_id_when_busy_is_refused_with_113() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.trigger(6);
    b.expect_refused(113);
    assert_eq!(b.h.shown.id, 5);
}

#[test]
fn trigger_with_a_new_id_when_a_result_waits_is_refused_with_111() {
    let mut b = Bench::waiting();
    b.trigger(6);
    b.expect_refused(111);
    b.expect(status::RESULT_VALID | status::PASS, 0);
}

#[test]
fn trigger_with_a_new_id_in_a_fault_is_refused_and_the_hardware_code_stays() {
    let mut b = Bench::fault();
    b.trigger(6);
    b.expect_refused(201);
    assert_eq!(b.input(5, 1), [3]);
}

// TRIGGER, same id

#[test]
fn trigger_with_the_acknowledged_id_when_ready_is_refused_with_104() {
    let mut b = Bench::waiting();
    b.control(ENABLE | RESULT_ACK);
    b.control(ENABLE);
    b.expect(status::READY, status::RESULT_VALID);
    b.trigger(5);
    b.expect_refused(104);
    b.trigger(0);
    b.expect_refused(104);
}

#[test]
fn trigger_with_the_same_id_when_busy_is_acknowledged_and_starts_nothing() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.trigger(5);
    b.expect(status::TRIGGER_ACK | status::BUSY, status::CMD_REJECTED);
    assert_eq!(b.orders, []);
}

#[test]
fn trigger_with_the_same_id_when_its_result_waits_is_acknowledged_and_the_result_stays() {
    let mut b = Bench::waiting();
    let before = b.input(12, 97);
    b.trigger(5);
    b.expect(status::TRIGGER_ACK | status::RESULT_VALID | status::PASS, status::CMD_REJECTED | status::BUSY);
    assert_eq!((b.input(12, 97), &b.orders[..]), (before, &[][..]));
}

// TRIGGER without a vehicle

#[test]
fn trigger_without_a_vehicle_when_ready_is_refused_with_116() {
    let mut b = Bench::owned();
    b.status(Status { presence_fitted: true, ..ready_status() });
    b.trigger(5);
    b.expect_refused(116);
    b.status(Status { presence_fitted: true, vehicle_present: true, ..ready_status() });
    b.trigger(5);
    b.expect(status::TRIGGER_ACK, 0);
}

// JOB_LOAD

#[test]
fn job_load_when_ready_loads() {
    let mut b = Bench::owned();
    b.write(PLC, 0, &[ENABLE | JOB_LOAD, 0, 0, 0, 12, 34]);
    b.expect(status::BUSY, status::READY | status::CMD_DONE);
    assert_eq!(b.orders, [Order::LoadJob { job: 12, model_code: 34 }]);
    assert_eq!(b.h.state(), State::JobLoad);
    b.carry_out();
    b.expect_done();
    b.expect(status::READY, status::BUSY);
}

#[test]
fn job_load_when_busy_is_refused_with_112() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.write(PLC, JOB_REQ, &[12]);
    b.control(ENABLE | JOB_LOAD);
    b.expect_refused(112);
}

#[test]
fn job_load_when_a_result_waits_is_refused_with_111() {
    let mut b = Bench::waiting();
    b.write(PLC, JOB_REQ, &[12]);
    b.control(ENABLE | JOB_LOAD);
    b.expect_refused(111);
}

#[test]
fn job_load_in_a_fault_loads() {
    let mut b = Bench::fault();
    b.write(PLC, JOB_REQ, &[12]);
    b.control(ENABLE | JOB_LOAD);
    assert_eq!(b.orders, [Order::LoadJob { job: 12, model_code: 0 }]);
    b.carry_out();
    b.expect_done();
}

#[test]
fn job_load_of_a_job_that_the_station_refuses_says_why() {
    let mut b = Bench::owned();
    b.control(ENABLE | JOB_LOAD); // JOB_REQ is 0
    b.expect_refused(105);
    b.write(PLC, JOB_REQ, &[12]);
    b.control(ENABLE | JOB_LOAD);
    b.orders.clear();
    b.report(Report::Refused { order: OrderKind::LoadJob, code: Code::NotReleased, detail: 12 });
    b.expect(0, status::BUSY);
    b.expect_refused(801);
}

// VERIFY

#[test]
fn verify_when_ready_verifies() {
    let mut b = Bench::owned();
    b.control(ENABLE | VERIFY);
    b.expect(status::BUSY, status::READY);
    assert_eq!((&b.orders[..], b.h.state()), (&[Order::Verify][..], State::Verify));
    b.carry_out();
    b.expect_done();
    b.control(ENABLE | VERIFY);
    b.orders.clear();
    b.report(Report::Refused { order: OrderKind::Verify, code: Code::VerifyScale, detail: 0 });
    b.expect_refused(703);
}

#[test]
fn verify_when_busy_is_refused_with_113() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.control(ENABLE | VERIFY);
    b.expect_refused(113);
}

#[test]
fn verify_when_a_result_waits_is_refused_with_111() {
    let mut b = Bench::waiting();
    b.control(ENABLE | VERIFY);
    b.expect_refused(111);
}

#[test]
fn verify_in_a_fault_is_refused() {
    let mut b = Bench::fault();
    b.control(ENABLE | VERIFY);
    b.expect_refused(201);
}

// ABORT

#[test]
fn abort_when_ready_is_done() {
    let mut b = Bench::owned();
    b.control(ENABLE | ABORT);
    b.expect_done();
    assert_eq!(b.orders, []);
}

#[test]
fn abort_when_busy_gives_result_code_5() {
    let mut b = Bench::busy();
    let Some(Order::Measure(t)) = b.orders.pop() else { panic!("a measurement") };
    b.control(ENABLE | ABORT);
    assert_eq!(b.orders, [Order::Abort]);
    b.report(Report::Finished(Box::new(Outcome { result: ResultCode::Aborted, ..good(&t) })));
    b.carry_out();
    b.expect(status::RESULT_VALID | status::CMD_DONE, status::PASS | status::BUSY);
    assert_eq!(b.result(), (5, false), "no pose, whatever the station says");
}

#[test]
fn abort_when_a_result_waits_is_done_and_the_result_stays() {
    let mut b = Bench::waiting();
    b.control(ENABLE | ABORT);
    b.expect(status::RESULT_VALID | status::PASS, 0);
    b.expect_done();
    assert_eq!(b.orders, []);
}

#[test]
fn abort_in_a_fault_is_done() {
    let mut b = Bench::fault();
    b.control(ENABLE | ABORT);
    b.expect_done();
}

// CLEAR_ERROR

#[test]
fn clear_error_when_ready_is_done() {
    let mut b = Bench::owned();
    b.report(Report::Error(Code::ImageMissing, 0));
    b.expect(status::ERROR | status::READY, 0);
    b.control(ENABLE | CLEAR_ERROR);
    b.expect(0, status::ERROR);
    assert_eq!(b.input(4, 2), [0, 0]);
    b.expect_done();
}

#[test]
fn clear_error_when_busy_is_done() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.control(ENABLE | CLEAR_ERROR);
    b.expect(status::CMD_DONE | status::BUSY, 0);
    assert_eq!(b.orders, []);
}

#[test]
fn clear_error_when_a_result_waits_is_done() {
    let mut b = Bench::waiting();
    b.control(ENABLE | CLEAR_ERROR);
    b.expect(status::RESULT_VALID, 0);
    b.expect_done();
}

#[test]
fn clear_error_in_a_fault_tests_again_and_then_it_is_ready_or_a_fault_again() {
    let mut b = Bench::fault();
    b.control(ENABLE | CLEAR_ERROR);
    b.expect(status::BUSY, status::CMD_DONE | status::ERROR);
    assert_eq!(b.orders, [Order::ClearError]);
    b.status(Status { state: State::SelfTest, ..ready_status() });
    b.carry_out();
    b.status(ready_status());
    b.expect(status::READY, status::ERROR);
    b.expect_done();
    let mut b = Bench::fault();
    b.control(ENABLE | CLEAR_ERROR);
    b.orders.clear();
    b.report(Report::Error(Code::CameraLost, 0));
    b.report(Report::Refused { order: OrderKind::ClearError, code: Code::CameraLost, detail: 0 });
    b.expect(status::ERROR, status::READY);
    b.expect_refused(201);
}

// RESULT_ACK

#[test]
fn result_ack_when_ready_does_nothing_but_ready_waits_for_it_to_drop() {
    let mut b = Bench::owned();
    b.control(ENABLE | RESULT_ACK);
    b.expect(0, status::READY | status::CMD_DONE | status::CMD_REJECTED);
    b.control(ENABLE);
    b.expect(status::READY, 0);
}

#[test]
fn result_ack_when_busy_does_nothing_and_does_not_acknowledge_what_is_to_come() {
    let mut b = Bench::busy();
    b.control(ENABLE | RESULT_ACK);
    b.carry_out();
    b.expect(status::RESULT_VALID, status::READY);
}

#[test]
fn result_ack_when_a_result_waits_clears_it() {
    let mut b = Bench::waiting();
    b.expect(status::ACQ_DONE, 0);
    b.control(ENABLE | RESULT_ACK);
    b.expect(status::ACQ_DONE, status::RESULT_VALID | status::PASS | status::READY);
    b.control(ENABLE);
    b.expect(status::READY, status::RESULT_VALID | status::ACQ_DONE);
}

#[test]
fn result_ack_in_a_fault_clears_the_result() {
    let mut b = Bench::waiting();
    b.report(Report::Error(Code::CameraLost, 0));
    b.status(Status { state: State::Fault, ..ready_status() });
    assert_eq!(b.h.state(), State::Fault);
    b.control(ENABLE | RESULT_ACK);
    b.expect(status::ERROR, status::RESULT_VALID);
}

// Owner lost

#[test]
fn owner_lost_when_ready_leaves_it_ready_and_unowned() {
    let mut b = Bench::owned();
    b.step(Event::Closed(PLC));
    b.expect(status::READY, status::OWNER_OK | status::PLC_HB_OK);
}

#[test]
fn owner_lost_when_busy_completes_and_the_result_waits() {
    let mut b = Bench::busy();
    b.step(Event::Closed(PLC));
    b.expect(status::BUSY, status::OWNER_OK);
    b.carry_out();
    b.expect(status::RESULT_VALID | status::PASS, status::READY);
    assert!(b.h.waiting());
}

#[test]
fn owner_lost_when_a_result_waits_leaves_it_for_the_next_owner() {
    let mut b = Bench::waiting();
    let before = b.input(12, 97);
    b.step(Event::Closed(PLC));
    assert!(b.write(OTHER, CONTROL, &[ENABLE]));
    b.expect(status::RESULT_VALID | status::PASS | status::OWNER_OK, status::READY);
    assert_eq!(b.input(12, 97), before);
    b.write(OTHER, CONTROL, &[ENABLE | RESULT_ACK]);
    b.write(OTHER, CONTROL, &[ENABLE]);
    b.expect(status::READY, status::RESULT_VALID);
}

#[test]
fn owner_lost_in_a_fault_stays_a_fault() {
    let mut b = Bench::fault();
    b.step(Event::Closed(PLC));
    b.expect(status::ERROR, status::READY | status::OWNER_OK);
    assert_eq!(b.h.state(), State::Fault);
}

// Decision 3: four phases, one command bit at a time

#[test]
fn two_command_bits_are_refused_with_101_and_neither_is_carried_out() {
    let mut b = Bench::owned();
    b.control(ENABLE | TRIGGER | JOB_LOAD);
    b.expect_refused(101);
    let mut b = Bench::owned();
    b.trigger(5);
    b.orders.clear();
    b.control(ENABLE | TRIGGER | ABORT);
    b.expect(status::TRIGGER_ACK | status::CMD_REJECTED | status::BUSY, 0);
    assert_eq!((b.input(4, 1), &b.orders[..]), (vec![101], &[][..]), "TRIGGER has not been dropped");
}

#[test]
fn a_command_bit_that_is_not_dropped_in_ten_seconds_is_code_122() {
    let mut trigger = Bench::owned();
    trigger.trigger(5);
    let mut done = Bench::owned();
    done.control(ENABLE | ABORT);
    let mut rejected = Bench::owned();
    rejected.control(ENABLE | JOB_LOAD);
    for mut b in [trigger, done, rejected] {
        b.pass(10 * SECOND - SECOND / 10);
        b.expect(0, status::ERROR);
        b.pass(SECOND / 5);
        b.expect(status::ERROR, 0);
        assert_eq!(b.input(4, 1), [122]);
        let seq = b.input(6, 2);
        b.pass(20 * SECOND);
        assert_eq!(b.input(6, 2), seq, "it is told once");
    }
    let mut dropped = Bench::busy();
    dropped.pass(60 * SECOND);
    dropped.expect(status::BUSY, status::ERROR);
}

#[test]
fn a_command_bit_dropped_too_early_leaves_its_answer_until_the_next_command() {
    let mut b = Bench::owned();
    b.control(ENABLE | VERIFY);
    b.control(ENABLE);
    b.carry_out();
    b.expect(status::CMD_DONE, status::BUSY);
    b.control(ENABLE);
    b.expect(status::CMD_DONE, 0);
    b.trigger(5);
    b.expect(status::TRIGGER_ACK, status::CMD_DONE);
}

#[test]
fn presence_replaces_trigger_and_all_else_is_the_same() {
    let mut b = Bench::new(true);
    b.control(ENABLE);
    b.report(Report::Began(Trigger::default()));
    b.expect(status::BUSY, status::TRIGGER_ACK | status::READY);
    b.report(Report::Acquired);
    b.expect(status::ACQ_DONE, 0);
    assert_eq!(b.h.state(), State::Processing);
    b.report(Report::Finished(Box::new(good(&Trigger::default()))));
    b.expect(status::RESULT_VALID | status::PASS, status::READY);
    // the next vehicle comes before the acknowledgement: it is ended, and the result that waits is not lost
    let before = b.input(12, 97);
    b.report(Report::Began(Trigger::default()));
    assert_eq!((&b.orders[..], b.input(4, 1)), (&[Order::Abort][..], vec![111]));
    b.report(Report::Finished(Box::new(Outcome { result: ResultCode::Aborted, ..good(&Trigger::default()) })));
    assert_eq!(b.input(12, 97), before);
    b.control(ENABLE | RESULT_ACK);
    b.control(ENABLE);
    b.expect(status::READY, status::RESULT_VALID);
    // its owner is lost while it is measured: the result waits for the next
    b.report(Report::Began(Trigger::default()));
    b.step(Event::Closed(PLC));
    b.report(Report::Finished(Box::new(good(&Trigger::default()))));
    assert!(b.h.waiting());
}

#[test]
fn results_without_an_owner_are_readable_need_no_acknowledgement_and_are_withdrawn() {
    let mut b = Bench::new(false);
    let cycle = |b: &mut Bench| {
        b.report(Report::Began(Trigger::default()));
        assert_eq!(b.result(), (0, false), "never a stale pose");
        b.expect(status::BUSY, status::RESULT_VALID | status::PASS);
        b.report(Report::Finished(Box::new(good(&Trigger::default()))));
        b.expect(status::RESULT_VALID | status::PASS | status::READY, 0);
    };
    cycle(&mut b);
    b.pass(20 * SECOND);
    b.expect(status::READY, status::WARNING);
    cycle(&mut b);
    assert_eq!(b.input(12, 1), [2]);
    b.control(ENABLE);
    b.expect(status::READY, status::RESULT_VALID | status::PASS);
    assert_eq!(b.result(), (0, false));
    // one that was under way when the owner came is not his vehicle
    b.step(Event::Closed(PLC));
    b.report(Report::Began(Trigger::default()));
    b.write(OTHER, CONTROL, &[ENABLE]);
    b.report(Report::Finished(Box::new(good(&Trigger::default()))));
    b.expect(status::READY, status::RESULT_VALID);
    assert_eq!(b.input(12, 1), [2]);
}

#[test]
fn a_trigger_that_crosses_a_cycle_of_the_stations_own_comes_after_it() {
    let mut b = Bench::owned();
    b.trigger(5);
    b.report(Report::Began(Trigger::default()));
    b.report(Report::Acquired);
    b.expect(status::BUSY, status::ACQ_DONE);
    b.report(Report::Finished(Box::new(good(&Trigger::default()))));
    b.expect(status::BUSY, status::RESULT_VALID);
    b.carry_out();
    b.expect(status::RESULT_VALID | status::ACQ_DONE, status::BUSY);
    assert_eq!(b.h.shown.id, 5);
}

// Decision 4: arm on zero

#[test]
fn a_bit_that_was_set_when_its_connection_became_owner_counts_after_it_has_been_zero() {
    for bits in [TRIGGER, JOB_LOAD, CLEAR_ERROR, VERIFY, ABORT] {
        let mut b = Bench::new(false);
        assert!(b.write(PLC, 0, &[ENABLE | bits, 0, 0, 5, 12]));
        b.expect(status::OWNER_OK, status::TRIGGER_ACK | status::CMD_DONE | status::CMD_REJECTED | status::BUSY);
        b.control(ENABLE | bits);
        assert_eq!(b.orders, []);
        b.control(ENABLE);
        b.control(ENABLE | bits);
        assert!(b.orders.len() == 1 || b.h.answer.is_some(), "{bits}");
    }
    // nor is a result acknowledged by a bit that a dead PLC left
    let mut b = Bench::waiting();
    b.step(Event::Closed(PLC));
    b.write(OTHER, CONTROL, &[ENABLE | RESULT_ACK]);
    b.expect(status::RESULT_VALID, 0);
    b.write(OTHER, CONTROL, &[ENABLE]);
    b.write(OTHER, CONTROL, &[ENABLE | RESULT_ACK]);
    b.expect(0, status::RESULT_VALID);
}

#[test]
fn a_bit_held_through_a_cleared_error_counts_after_it_has_been_zero() {
    let mut b = Bench::fault();
    b.trigger(5);
    b.control(ENABLE);
    b.control(ENABLE | CLEAR_ERROR);
    b.carry_out();
    b.status(ready_status());
    b.control(ENABLE | CLEAR_ERROR | TRIGGER);
    assert_eq!((b.input(4, 1), &b.orders[..]), (vec![101], &[][..]));
    b.control(ENABLE | TRIGGER);
    assert_eq!(b.orders, []);
    b.control(ENABLE);
    b.control(ENABLE | TRIGGER);
    assert_eq!(b.orders.len(), 1);
}

#[test]
fn a_readers_connection_changes_nothing_for_the_owner() {
    let mut b = Bench::busy();
    let before = Snapshot::new(&b.h);
    assert!(!b.write(OTHER, CONTROL, &[ENABLE | ABORT]));
    assert!(!b.write(OTHER, 17, &[1]));
    b.step(Event::Closed(OTHER));
    assert_eq!(Snapshot::new(&b.h), before);
}

// Decision 5

#[test]
fn trigger_id_and_vin_are_echoed_from_the_trigger_on_and_in_the_result() {
    let mut b = Bench::owned();
    b.trigger(0x0001_0005);
    assert_eq!(b.input(13, 2), [1, 5]);
    assert_eq!(b.input(86, 9), words::of_text("WBA00000000000005", 9));
    b.carry_out();
    assert_eq!((b.input(13, 2), b.input(86, 2)), (vec![1, 5], vec![0x5742, 0x4130]));
}

#[test]
fn a_trigger_that_the_station_refuses_has_no_result_and_says_why() {
    let mut b = Bench::busy();
    b.orders.clear();
    b.report(Report::Refused { order: OrderKind::Measure, code: Code::UnknownJob, detail: 9 });
    b.expect(status::CMD_REJECTED | status::READY, status::BUSY | status::TRIGGER_ACK | status::RESULT_VALID);
    assert_eq!((b.input(4, 2), b.result()), (vec![105, 9], (0, false)));
    b.control(ENABLE);
    b.expect(status::CMD_REJECTED, 0); // TRIGGER had been dropped: a slow PLC still sees it
    b.trigger(5);
    b.expect(status::TRIGGER_ACK | status::BUSY, status::CMD_REJECTED);
}

// Decision 6

#[test]
fn the_result_is_frozen_from_valid_to_acknowledged() {
    let mut b = Bench::waiting();
    let before = b.input(12, 97);
    b.write(PLC, 2, &[9, 9, 9, 9]);
    let ago = Some(99 * SECOND);
    b.status(Status { verified_ago: ago, camera_celsius: Some(50.0), active_job: 3, ..ready_status() });
    b.pass(5 * SECOND);
    assert_eq!(b.input(12, 97), before);
    assert_eq!(b.input(12, 1), b.input(119, 1));
}

#[test]
fn parameters_written_while_busy_wait_for_the_next_trigger() {
    let mut b = Bench::busy();
    b.write(PLC, 2, &[0, 6, 12, 0, 0, 8]);
    b.carry_out();
    assert_eq!(b.input(13, 2), [0, 5]);
    b.control(ENABLE | RESULT_ACK);
    b.control(ENABLE);
    b.control(ENABLE | TRIGGER);
    let [Order::Measure(t)] = &b.orders[..] else { panic!("{:?}", b.orders) };
    assert_eq!((t.id, t.job, t.keep_images), (6, 12, true));
}

#[test]
fn the_result_sequence_counts_up_and_is_never_zero() {
    let mut b = Bench::owned();
    b.h.result_seq = 0xFFFE;
    for (id, seq) in [(1, 0xFFFF), (2, 1), (3, 2)] {
        b.trigger(id);
        b.carry_out();
        assert_eq!((b.input(12, 1), b.input(119, 1)), (vec![seq], vec![seq]));
        b.control(ENABLE | RESULT_ACK);
        b.control(ENABLE);
    }
}

// Decision 8

#[test]
fn at_the_acknowledgement_of_a_trigger_all_of_the_last_result_is_invalid() {
    let mut b = Bench::waiting();
    assert_eq!(b.result(), (1, true));
    b.control(ENABLE | RESULT_ACK);
    assert_eq!(b.result(), (1, true), "readable until the next vehicle");
    b.control(ENABLE);
    b.trigger(6);
    b.expect(status::TRIGGER_ACK, status::RESULT_VALID | status::PASS | status::ACQ_DONE);
    let r = b.input(0, 120);
    assert_eq!(r[12..17], [1, 0, 6, 0, 0], "sequence stays, echo is new, code and mask are 0");
    let long = |range: std::ops::Range<usize>| r[range].chunks(2).all(|w| w == [0x8000, 0]);
    assert!(long(17..29) && long(50..74) && long(103..109));
    let short = |range: std::ops::Range<usize>| r[range].iter().all(|w| *w == 0xFFFF);
    assert!(short(29..45) && short(47..50) && short(74..86));
    assert_eq!((&r[45..47], &r[95..103]), (&[0x8000; 2][..], &[0; 8][..]));
}

// Decision 9

#[test]
fn pass_is_for_result_code_1_only_and_a_pose_for_1_to_3() {
    use ResultCode::{Aborted, NotMeasurable, Ok, OutOfLimits, TooUncertain};
    for (result, pass, pose) in [
        (Ok, true, true),
        (OutOfLimits, false, true),
        (TooUncertain, false, true),
        (NotMeasurable, false, false),
        (Aborted, false, false),
    ] {
        let mut b = Bench::busy();
        let Some(Order::Measure(t)) = b.orders.pop() else { panic!("a measurement") };
        let code = (result != Ok).then_some(Code::NotFound);
        b.report(Report::Finished(Box::new(Outcome { result, code, detail: 2, ..good(&t) })));
        b.expect(status::RESULT_VALID, status::ERROR);
        assert_eq!(b.h.status_bits() & status::PASS != 0, pass);
        assert_eq!(b.result(), (result as u16, pose));
        assert_eq!(b.input(4, 2), if result == Ok { [0, 0] } else { [401, 2] });
    }
}

// Decision 10

#[test]
fn a_lost_heartbeat_is_code_123_and_releases_the_ownership() {
    let mut b = Bench::owned();
    b.expect(0, status::PLC_HB_OK);
    b.pass(SECOND);
    b.expect(status::PLC_HB_OK, 0);
    b.now += 3 * SECOND;
    b.step(Event::Tick);
    b.expect(status::ERROR | status::READY, status::OWNER_OK | status::PLC_HB_OK);
    assert_eq!((b.input(4, 1), b.input(216, 2)), (vec![123], vec![0, 1]));
    assert!(b.write(OTHER, CONTROL, &[ENABLE]));
}

#[test]
fn a_heartbeat_lost_while_busy_lets_the_cycle_complete_and_its_result_wait() {
    let mut b = Bench::busy();
    b.now += 3 * SECOND;
    b.step(Event::Tick);
    b.expect(status::BUSY | status::ERROR, status::OWNER_OK);
    assert_eq!(b.input(3, 1)[0] & not_ready::PLC_HEARTBEAT, not_ready::PLC_HEARTBEAT);
    b.carry_out();
    assert!(b.h.waiting());
}

#[test]
fn who_lost_the_ownership_by_its_heartbeat_owns_again_when_it_beats_or_drops_enable() {
    let lost = || {
        let mut b = Bench::owned();
        b.now += 3 * SECOND;
        b.step(Event::Tick);
        assert!(!b.control(ENABLE), "a stopped PLC repeats its outputs");
        b
    };
    let mut b = lost();
    assert!(b.write(PLC, 0, &[ENABLE, 1]));
    let mut b = lost();
    assert!(!b.write(PLC, PLC_HEARTBEAT, &[1]), "it does not own");
    assert!(b.control(ENABLE));
    let mut b = lost();
    assert!(!b.control(0));
    assert!(b.control(ENABLE));
}

#[test]
fn the_device_heartbeat_advances_with_each_beat_only() {
    let mut b = Bench::owned();
    b.pass(SECOND);
    assert_eq!(b.input(1, 1), [0]);
    b.step(Event::Beat);
    assert_eq!(b.input(1, 1), [1]);
}

// Decision 11

#[test]
fn who_sets_enable_first_owns_until_it_clears_it() {
    let mut b = Bench::new(false);
    assert!(!b.write(OTHER, PLC_HEARTBEAT, &[1]), "without ENABLE nobody writes");
    assert!(b.control(ENABLE) && !b.write(OTHER, CONTROL, &[ENABLE]));
    b.trigger(5);
    assert!(b.control(0));
    b.expect(status::BUSY, status::OWNER_OK | status::TRIGGER_ACK);
    assert!(b.write(OTHER, CONTROL, &[ENABLE]));
    b.carry_out();
    b.expect(status::RESULT_VALID, 0);
}

#[test]
fn enable_falling_with_a_command_starts_nothing() {
    let mut b = Bench::owned();
    b.write(PLC, 0, &[TRIGGER, 0, 0, 5]);
    b.expect(0, status::OWNER_OK | status::TRIGGER_ACK);
    assert_eq!(b.orders, []);
}

// Decision 12

#[test]
fn a_full_queue_is_code_113() {
    let mut b = Bench::owned();
    b.trigger(5);
    let order = b.orders.remove(0);
    b.step(Event::Undelivered(order));
    b.expect(status::READY, status::BUSY | status::TRIGGER_ACK);
    b.expect_refused(113);
    b.control(ENABLE | STANDBY);
    b.orders.clear();
    b.step(Event::Undelivered(Order::StandBy(true)));
    assert_eq!(b.orders, []);
    b.step(Event::Tick);
    assert_eq!(b.orders, [Order::StandBy(true)]);
}

#[test]
fn an_acknowledgement_that_does_not_come_is_a_warning_and_the_result_stays() {
    let mut b = Bench::waiting();
    b.pass(10 * SECOND - SECOND / 10);
    b.expect(0, status::WARNING);
    b.pass(SECOND / 5);
    b.expect(status::WARNING | status::RESULT_VALID | status::PASS, status::ERROR);
    assert_eq!(b.input(4, 1), [121]);
    b.trigger(6);
    b.expect_refused(111);
    b.control(ENABLE | RESULT_ACK);
    b.expect(0, status::WARNING | status::RESULT_VALID);
}

#[test]
fn a_trigger_the_station_is_not_fit_for_says_why() {
    let service = NotReady { service: true, ..NotReady::default() };
    let expired = NotReady { calibration: true, ..NotReady::default() };
    for (state, not_ready, code) in [
        (State::Boot, NotReady::default(), 115),
        (State::WarmUp, NotReady::default(), 115),
        (State::Service, NotReady::default(), 114),
        (State::Ready, service, 114),
        (State::Ready, expired, 701),
        (State::Processing, NotReady::default(), 113),
    ] {
        let mut b = Bench::owned();
        b.status(Status { state, not_ready, ..ready_status() });
        b.expect(0, status::READY);
        b.trigger(5);
        b.expect_refused(code);
        assert_eq!(b.input(214, 2), [0, 1], "a rejected trigger is counted");
    }
}

// Decision 13

#[test]
fn a_write_that_sets_something_reserved_is_rejected_whole_with_103() {
    for (address, words) in [
        (0, &[0x0100 | ENABLE][..]),
        (6, &[1]),
        (7, &[1]),
        (16, &[0, 7]),
        (17, &[1]),
        (63, &[1]),
        (0, &[ENABLE | TRIGGER, 0, 0, 5, 0, 0, 1]),
    ] {
        let mut b = Bench::owned();
        assert!(b.write(PLC, address, words), "never an exception");
        b.expect(status::CMD_REJECTED | status::OWNER_OK, status::TRIGGER_ACK);
        assert_eq!((b.input(4, 1), &b.orders[..]), (vec![103], &[][..]));
        assert_eq!(b.h.holding[1..], [0; 63], "nothing of it is taken");
        b.trigger(5);
        b.expect(status::TRIGGER_ACK, status::CMD_REJECTED);
    }
    let mut b = Bench::new(false);
    assert!(b.write(PLC, 0, &[ENABLE | 0x8000]));
    b.expect(status::CMD_REJECTED, status::OWNER_OK); // who wants to own sees why it does not
    let mut b = Bench::owned();
    assert!(b.write(PLC, 17, &[0; 47]));
    b.expect(0, status::CMD_REJECTED);
}

#[test]
fn stand_by_is_a_level_that_ends_with_the_ownership() {
    let mut b = Bench::owned();
    b.control(ENABLE | STANDBY);
    assert_eq!(b.orders, [Order::StandBy(true)]);
    b.expect(0, status::READY);
    b.orders.clear();
    b.control(ENABLE | STANDBY);
    b.write(PLC, 2, &[0, 5]);
    b.control(ENABLE | STANDBY | TRIGGER);
    assert_eq!((b.input(4, 1), &b.orders[..]), (vec![114], &[][..]));
    b.step(Event::Closed(PLC));
    assert_eq!(b.orders, [Order::StandBy(false)]);
    b.expect(status::READY, 0);
}

#[test]
fn the_same_error_twice_is_seen() {
    let mut b = Bench::owned();
    b.report(Report::Error(Code::ImageMissing, 0));
    let first = b.input(4, 4);
    b.report(Report::Error(Code::ImageMissing, 0));
    assert_eq!((first, b.input(4, 4)), (vec![202, 0, 0, 1], vec![202, 0, 0, 2]));
    // a warning is told when it comes, and measuring goes on
    b.status(Status { warning: Some(Code::StorageFull), ..ready_status() });
    b.status(Status { warning: Some(Code::StorageFull), ..ready_status() });
    b.expect(status::WARNING | status::READY, 0);
    assert_eq!(b.input(4, 4), [901, 0, 0, 3]);
}

#[test]
fn whatever_is_written_and_reported_no_pose_is_shown_without_its_vehicle() {
    arbtest::arbtest(|u| {
        let mut b = Bench::new(u.arbitrary()?);
        for _ in 0..40 {
            b.now += Duration::from_millis(u64::from(u.arbitrary::<u16>()?));
            let client: ClientId = u.int_in_range(1..=2)?;
            match u.int_in_range(0..=8)? {
                0..=3 => {
                    let control = u16::from(u.arbitrary::<u8>()?) | ENABLE;
                    b.write(client, 0, &[control, u.arbitrary()?, 0, u.int_in_range(0..=3)?, 7]);
                }
                4 => drop(b.step(Event::Closed(client))),
                5 => b.carry_out(),
                6 => b.report(Report::Began(Trigger::default())),
                7 => b.report(Report::Finished(Box::new(good(&Trigger::default())))),
                _ => drop(b.step(Event::Tick)),
            }
            let bits = b.h.status_bits();
            let (valid, ready) = (bits & status::RESULT_VALID != 0, bits & status::READY != 0);
            assert!(!valid || b.result() == (1, true));
            assert!(bits & status::PASS == 0 || valid);
            assert!(!(valid && bits & status::BUSY != 0 && b.h.cycle.as_ref().is_some_and(|c| !c.unwanted)));
            assert!(!(ready && (bits & status::BUSY != 0 || b.h.waiting())));
            assert_eq!(bits & status::OWNER_OK == 0, b.h.holding[0] == 0);
            assert!((b.h.holding[0] & 0xFF00, b.input(12, 1)) == (0, b.input(119, 1)));
        }
        Ok(())
    });
}

#[test]
fn the_station_is_told_of_every_change_of_ownership_and_again_where_it_did_not_hear() {
    let mut h = Bench::new(false).h;
    let mut owns = |now: u64, event: Event| {
        let orders = h.step(Duration::from_secs(now), event).orders;
        orders.into_iter().filter_map(|o| if let Order::Own(own) = o { Some(own) } else { None }).collect::<Vec<_>>()
    };
    assert_eq!(owns(1, Event::Write { client: PLC, address: CONTROL, words: &[ENABLE] }), [true]);
    assert!(owns(1, Event::Undelivered(Order::Own(true))).is_empty());
    assert_eq!(owns(1, Event::Tick), [true]);
    assert!(owns(1, Event::Tick).is_empty());
    assert_eq!(owns(2, Event::Closed(PLC)), [false]);
}
