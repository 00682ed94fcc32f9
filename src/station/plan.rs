//! What the station does next. In: how it is, what happened. Out: how it is then, what is to be done.
//! Pure: no device, no clock. Not here: what happens within a cycle; the handshake.

use crate::code::Code;
use crate::plc::{Order, OrderKind, State as Mode, Trigger};

/// Whether the station begins cycles by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByItself {
    Never,
    /// Until a PLC takes ownership: the built-in simulated station.
    Unowned,
    /// `trigger = "presence"`.
    Always,
}

/// How the station is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct State {
    pub(super) mode: Mode,
    pub(super) stand_by: bool,
    pub(super) owned: bool,
    pub(super) warm: bool,
    pub(super) by_itself: ByItself,
    /// What is wrong with a device.
    pub(super) fault: Option<Code>,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// The devices are there.
    Began,
    /// The devices were tried.
    Tested(Result<(), Code>),
    /// Camera and projector are warm.
    Warm,
    /// The PLC wants something.
    Order(Order),
    /// A vehicle has come and stands.
    Arrived,
    /// A cycle, a verification or a job's loading has ended; with what is wrong with a device.
    Ended(Option<Code>),
    /// A fault may be over.
    Retry,
}

/// What is to be done, in this order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// Bars and projector off.
    Dark,
    /// Try the devices.
    Test,
    /// Measure a vehicle; by itself or as it was ordered.
    Measure(Trigger, Cause),
    Load {
        job: u16,
        model_code: u16,
    },
    Verify,
    Done(OrderKind),
    Refuse(OrderKind, Code),
    /// Tell the PLC of a new fault.
    Latch(Code),
}

/// Who wanted a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    Ordered,
    Arrived,
}

/// Why nothing is measured now; `None`: it can be.
fn refusal(state: &State) -> Option<Code> {
    match state.mode {
        Mode::Fault => Some(state.fault.unwrap_or(Code::CameraLost)),
        Mode::Boot | Mode::SelfTest | Mode::WarmUp => Some(Code::TriggerInWarmUp),
        _ if state.stand_by => Some(Code::TriggerInService),
        Mode::Ready => None,
        _ => Some(Code::TriggerWhileBusy),
    }
}

/// Where the station is when nothing goes on.
fn at_rest(state: &State) -> Mode {
    match (state.fault, state.warm) {
        (Some(_), _) => Mode::Fault,
        (None, false) => Mode::WarmUp,
        (None, true) => Mode::Ready,
    }
}

/// What follows from an event.
pub(super) fn plan(state: &mut State, event: Event) -> Vec<Action> {
    use Action::{Dark, Done, Latch, Load, Measure, Refuse, Test, Verify};
    match event {
        Event::Began => {
            state.mode = Mode::SelfTest;
            vec![Dark, Test]
        }
        Event::Tested(result) => {
            let before = state.fault;
            state.fault = result.err();
            state.mode = at_rest(state);
            match state.fault {
                Some(code) if before != Some(code) => vec![Dark, Latch(code)],
                _ => vec![Dark],
            }
        }
        Event::Warm => {
            state.warm = true;
            if state.mode == Mode::WarmUp {
                state.mode = Mode::Ready;
            }
            Vec::new()
        }
        Event::Retry if state.mode == Mode::Fault => vec![Test],
        Event::Retry => Vec::new(),
        Event::Ended(fault) => {
            let news = fault.filter(|code| state.fault != Some(*code));
            state.fault = fault.or(state.fault);
            state.mode = at_rest(state);
            std::iter::once(Dark).chain(news.map(Latch)).collect()
        }
        Event::Arrived => {
            let wanted = match state.by_itself {
                ByItself::Never => false,
                ByItself::Unowned => !state.owned,
                ByItself::Always => true,
            };
            if !wanted || refusal(state).is_some() {
                return Vec::new();
            }
            state.mode = Mode::Acquiring;
            vec![Measure(Trigger::default(), Cause::Arrived)]
        }
        Event::Order(Order::Measure(trigger)) => match refusal(state) {
            Some(code) => vec![Refuse(OrderKind::Measure, code)],
            None => {
                state.mode = Mode::Acquiring;
                vec![Measure(trigger, Cause::Ordered)]
            }
        },
        Event::Order(Order::LoadJob { job, model_code }) => {
            state.mode = Mode::JobLoad;
            vec![Load { job, model_code }]
        }
        Event::Order(Order::Verify) => match refusal(state) {
            Some(code) => vec![Refuse(OrderKind::Verify, code)],
            None => {
                state.mode = Mode::Verify;
                vec![Verify]
            }
        },
        Event::Order(Order::Abort) => vec![Dark, Done(OrderKind::Abort)],
        Event::Order(Order::ClearError) => {
            let test = (state.mode == Mode::Fault).then(|| {
                state.fault = None; // what is still wrong is told once more
                state.mode = Mode::SelfTest;
                Test
            });
            test.into_iter().chain([Done(OrderKind::ClearError)]).collect()
        }
        Event::Order(Order::StandBy(on)) => {
            state.stand_by = on;
            if on { vec![Dark] } else { Vec::new() }
        }
        Event::Order(Order::Own(owned)) => {
            state.owned = owned;
            Vec::new()
        }
    }
}

/// What is answered while something goes on; `None`: it is taken note of.
pub(super) fn while_busy(order: &Order) -> Option<(OrderKind, Code)> {
    match order {
        Order::Measure(_) => Some((OrderKind::Measure, Code::TriggerWhileBusy)),
        Order::LoadJob { .. } => Some((OrderKind::LoadJob, Code::JobWhileBusy)),
        Order::Verify => Some((OrderKind::Verify, Code::TriggerWhileBusy)),
        Order::Abort | Order::ClearError | Order::StandBy(_) | Order::Own(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(mode: Mode) -> State {
        let fault = (mode == Mode::Fault).then_some(Code::CameraLost);
        State { mode, stand_by: false, owned: true, warm: true, by_itself: ByItself::Unowned, fault }
    }

    fn trigger(id: u32) -> Trigger {
        Trigger { id, ..Trigger::default() }
    }

    #[test]
    fn every_event_in_every_state_has_its_actions_and_its_next_state() {
        use Action::{Dark, Done, Latch, Load, Refuse, Test, Verify};
        let measure = |id| Event::Order(Order::Measure(trigger(id)));
        let load = || Event::Order(Order::LoadJob { job: 3, model_code: 0 });
        let ordered = |order| Event::Order(order);
        let rows: Vec<(Mode, Event, Vec<Action>, Mode)> = vec![
            (Mode::Boot, Event::Began, vec![Dark, Test], Mode::SelfTest),
            (Mode::SelfTest, Event::Tested(Ok(())), vec![Dark], Mode::Ready),
            (Mode::SelfTest, Event::Tested(Err(Code::LightFault)), vec![Dark, Latch(Code::LightFault)], Mode::Fault),
            (Mode::Fault, Event::Retry, vec![Test], Mode::Fault),
            (Mode::Fault, Event::Tested(Err(Code::CameraLost)), vec![Dark], Mode::Fault),
            (Mode::Fault, Event::Tested(Ok(())), vec![Dark], Mode::Ready),
            (Mode::Ready, Event::Retry, vec![], Mode::Ready),
            (Mode::Ready, measure(7), vec![Action::Measure(trigger(7), Cause::Ordered)], Mode::Acquiring),
            (Mode::SelfTest, measure(7), vec![Refuse(OrderKind::Measure, Code::TriggerInWarmUp)], Mode::SelfTest),
            (Mode::WarmUp, measure(7), vec![Refuse(OrderKind::Measure, Code::TriggerInWarmUp)], Mode::WarmUp),
            (Mode::WarmUp, Event::Warm, vec![], Mode::Ready),
            (Mode::Fault, measure(7), vec![Refuse(OrderKind::Measure, Code::CameraLost)], Mode::Fault),
            (Mode::Acquiring, Event::Ended(None), vec![Dark], Mode::Ready),
            (Mode::Acquiring, Event::Ended(Some(Code::LightFault)), vec![Dark, Latch(Code::LightFault)], Mode::Fault),
            (Mode::Ready, load(), vec![Load { job: 3, model_code: 0 }], Mode::JobLoad),
            (Mode::Fault, load(), vec![Load { job: 3, model_code: 0 }], Mode::JobLoad),
            (Mode::Ready, ordered(Order::Verify), vec![Verify], Mode::Verify),
            (Mode::Fault, ordered(Order::Verify), vec![Refuse(OrderKind::Verify, Code::CameraLost)], Mode::Fault),
            (Mode::Ready, ordered(Order::Abort), vec![Dark, Done(OrderKind::Abort)], Mode::Ready),
            (Mode::Fault, ordered(Order::Abort), vec![Dark, Done(OrderKind::Abort)], Mode::Fault),
            (Mode::Ready, ordered(Order::ClearError), vec![Done(OrderKind::ClearError)], Mode::Ready),
            (Mode::Fault, ordered(Order::ClearError), vec![Test, Done(OrderKind::ClearError)], Mode::SelfTest),
            (Mode::Ready, ordered(Order::StandBy(true)), vec![Dark], Mode::Ready),
            (Mode::Ready, Event::Arrived, vec![], Mode::Ready), // owned
        ];
        for (before, event, actions, after) in rows {
            let mut state = state(before);
            let got = plan(&mut state, event.clone());
            assert_eq!((got, state.mode), (actions, after), "{before:?} {event:?}");
        }
    }

    #[test]
    fn vehicles_are_measured_by_themselves_as_configured_until_a_plc_owns_the_station() {
        for (by_itself, owned, measured) in [
            (ByItself::Never, false, false),
            (ByItself::Unowned, false, true),
            (ByItself::Unowned, true, false),
            (ByItself::Always, true, true),
        ] {
            let mut state = State { by_itself, owned: !owned, ..state(Mode::Ready) };
            plan(&mut state, Event::Order(Order::Own(owned)));
            assert_eq!(!plan(&mut state, Event::Arrived).is_empty(), measured, "{by_itself:?} {owned}");
        }
    }

    #[test]
    fn nothing_is_measured_in_stand_by() {
        let mut state = State { by_itself: ByItself::Always, ..state(Mode::Ready) };
        plan(&mut state, Event::Order(Order::StandBy(true)));
        assert_eq!(plan(&mut state, Event::Arrived), []);
        let refused = vec![Action::Refuse(OrderKind::Measure, Code::TriggerInService)];
        assert_eq!(plan(&mut state, Event::Order(Order::Measure(trigger(1)))), refused);
        plan(&mut state, Event::Order(Order::StandBy(false)));
        assert_eq!(plan(&mut state, Event::Order(Order::Measure(trigger(1)))).len(), 1);
        assert_eq!(state.mode, Mode::Acquiring);
    }

    #[test]
    fn a_cold_station_is_not_ready_after_its_test_nor_after_a_fault() {
        let mut state = State { warm: false, ..state(Mode::SelfTest) };
        plan(&mut state, Event::Tested(Ok(())));
        assert_eq!(state.mode, Mode::WarmUp);
        plan(&mut state, Event::Tested(Err(Code::CameraLost)));
        plan(&mut state, Event::Warm);
        assert_eq!(state.mode, Mode::Fault);
        plan(&mut state, Event::Tested(Ok(())));
        assert_eq!(state.mode, Mode::Ready);
    }
}
