//! The Modbus TCP server: one thread for all connections, and one that takes the station's reports.
//! In:  connections, reports, the station's pulse. Out: responses, orders.
//! Not here: what a frame is (the guard), what it is answered (the service), when orders are given (the handshake).

use super::exchange::{Identity, Order, Pulse, Report};
use super::guard::Reader;
use super::handshake::{ClientId, Event, Handshake, Settings};
use super::network::Network;
use super::service::reply;
use super::shared::{Shared, View};
use super::words::WordOrder;
use std::net::{IpAddr, SocketAddr};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::time::MissedTickBehavior;

/// Between two looks at the handshake's time-outs.
const TICK: Duration = Duration::from_millis(50);
/// Between two steps of DEVICE_HEARTBEAT.
const BEAT: Duration = Duration::from_millis(200);
/// After `accept` failed, as it does while there are no file descriptors.
const PAUSE: Duration = Duration::from_millis(100);
/// A client that does not read its response for so long is gone.
const WRITE: Duration = Duration::from_secs(5);
/// Between two lines in the log about one client's refused writes.
const TELL: Duration = Duration::from_secs(10);

/// The station's configuration, as far as the PLC goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Port 0: any that is free.
    pub listen: SocketAddr,
    /// Who may connect; none: nobody.
    pub allow: Vec<Network>,
    /// Of 32- and 64-bit values.
    pub word_order: WordOrder,
    /// PLC_HEARTBEAT must change within this time; 0.5 to 30 s.
    pub heartbeat_timeout: Duration,
    /// `trigger = "presence"`: vehicles trigger by themselves, and their results need the owner's acknowledgement.
    pub presence: bool,
    /// DEVICE_HEARTBEAT stops when the station's pulse has not moved for so long.
    pub patience: Duration,
}

/// The built-in simulated station's.
impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 5020)),
            allow: vec![IpAddr::from([127, 0, 0, 1]).into()],
            word_order: WordOrder::HighFirst,
            heartbeat_timeout: Duration::from_secs(3),
            presence: false,
            patience: Duration::from_secs(2),
        }
    }
}

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that is not allowed.
    #[error("plc.{key} = {value}, allowed: {allowed}")]
    Setting {
        /// The key.
        key: &'static str,
        /// What was found.
        value: String,
        /// What would do.
        allowed: &'static str,
    },
    /// The address cannot be listened on.
    #[error("plc.listen = {address}: cannot listen there")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// No thread, or no event queue.
    #[error("the PLC server: {what} cannot be made")]
    System {
        /// What.
        what: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
}

/// A server that runs until it is dropped. Dropping it drops the sender of orders, which ends the station.
pub struct Server {
    shared: Arc<Shared>,
    local_addr: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens, and serves on threads of its own. When the last sender of `reports` is gone, the registers stay as
    /// they are.
    pub fn start(
        config: Config,
        identity: Identity,
        orders: SyncSender<Order>,
        reports: Receiver<Report>,
        pulse: Arc<Pulse>,
    ) -> Result<Self, Error> {
        if !(Duration::from_millis(500)..=Duration::from_secs(30)).contains(&config.heartbeat_timeout) {
            let value = format!("{:?}", config.heartbeat_timeout);
            return Err(Error::Setting { key: "heartbeat_timeout", value, allowed: "0.5 s to 30 s" });
        }
        let listen = |source| Error::Listen { address: config.listen, source };
        let system = |what| move |source| Error::System { what, source };
        let listener = std::net::TcpListener::bind(config.listen).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let local_addr = listener.local_addr().map_err(listen)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
        let runtime = runtime.map_err(system("its event queue"))?;
        let listener = {
            let _entered = runtime.enter();
            TcpListener::from_std(listener).map_err(listen)?
        };
        let Config { word_order, heartbeat_timeout, presence, allow, patience, .. } = config;
        let settings = Settings { heartbeat_timeout, presence, word_order };
        let shared = Arc::new(Shared::new(Handshake::new(settings, identity), orders));
        let (stop, stopped) = oneshot::channel();
        let here = shared.clone();
        let serve = move || {
            runtime.block_on(async move {
                let (listener, allow, next) = (Arc::new(listener), Arc::new(allow), Arc::new(AtomicU64::new(0)));
                tokio::select! {
                    () = forever("accepting", || accept(here.clone(), listener.clone(), allow.clone(), next.clone())) => {}
                    () = forever("supervising", || supervise(here.clone(), pulse.clone(), patience)) => {}
                    _ = stopped => {}
                }
            });
        };
        let thread = std::thread::Builder::new().name("plc".into()).spawn(serve).map_err(system("its thread"))?;
        let server = Self { shared: shared.clone(), local_addr, stop: Some(stop), thread: Some(thread) };
        let take = move || {
            for report in reports {
                survive("a report", || shared.step(Event::Report(report)));
            }
        };
        std::thread::Builder::new().name("plc-reports".into()).spawn(take).map_err(system("its thread"))?;
        Ok(server)
    }

    /// Where it listens.
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// The PLC's side at this moment.
    pub fn view(&self) -> View {
        self.shared.view()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // a panic of ours has been told
        }
        self.shared.close();
    }
}

/// Runs `what`; a panic is a bug of ours, and no reason to stop serving.
fn survive(what: &str, task: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(task)).is_err() {
        tracing::error!("a panic at {what}; this is a bug, please report it");
    }
}

/// Runs a task again and again; it ends by a panic only.
async fn forever<T: Future<Output = ()> + Send + 'static>(what: &str, mut task: impl FnMut() -> T) {
    loop {
        if tokio::spawn(task()).await.is_err() {
            tracing::error!("a panic while {what}; this is a bug, please report it");
            tokio::time::sleep(PAUSE).await;
        }
    }
}

/// Tells the handshake that time passes, and that the station lives if its pulse has moved lately.
async fn supervise(shared: Arc<Shared>, pulse: Arc<Pulse>, patience: Duration) {
    let mut ticks = tokio::time::interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let (mut count, mut moved, mut beat, mut hung) = (pulse.count(), Instant::now(), Duration::ZERO, false);
    loop {
        ticks.tick().await;
        shared.step(Event::Tick);
        if pulse.count() != count {
            (count, moved) = (pulse.count(), Instant::now());
        }
        if hung != (moved.elapsed() > patience) {
            hung = !hung;
            if hung {
                tracing::error!("no sign of life from the station for {patience:?}: DEVICE_HEARTBEAT stops");
            } else {
                tracing::info!("the station lives again");
            }
        }
        if !hung && shared.elapsed() >= beat {
            beat = (beat + BEAT).max(shared.elapsed());
            shared.step(Event::Beat);
        }
    }
}

/// Takes connections. An error of `accept` is waited out: the connections that there are go on.
async fn accept(shared: Arc<Shared>, listener: Arc<TcpListener>, allow: Arc<Vec<Network>>, next: Arc<AtomicU64>) {
    let mut failing = false;
    loop {
        let (stream, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                if !failing {
                    tracing::error!("no connection can be taken: {e}");
                }
                failing = true;
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        failing = false;
        if !allow.iter().any(|network| network.contains(address.ip())) {
            tracing::warn!(%address, "a connection from outside plc.allow was closed");
            continue;
        }
        let id = next.fetch_add(1, Ordering::Relaxed);
        let leave = Leave { shared: shared.clone(), id };
        // it does not run before it is on the list: one thread, and no await in between
        let task = tokio::spawn(serve(stream, address, leave));
        shared.join(id, address, task.abort_handle());
    }
}

/// Takes a connection off the list, however it ends.
struct Leave {
    shared: Arc<Shared>,
    id: ClientId,
}

impl Drop for Leave {
    fn drop(&mut self) {
        self.shared.leave(self.id);
    }
}

/// One connection, until it is closed or broken.
async fn serve(mut stream: TcpStream, address: SocketAddr, leave: Leave) {
    let (shared, id) = (&leave.shared, leave.id);
    let _ = stream.set_nodelay(true); // slower without, not wrong
    tracing::info!(%address, "connected");
    let (mut reader, mut told) = (Reader::new(), None::<Instant>);
    loop {
        let frame = match reader.next(&mut stream).await {
            Ok(Some(frame)) => frame,
            Ok(None) => return tracing::info!(%address, "closed"),
            Err(e) => return tracing::warn!(%address, "broken: {e}"),
        };
        shared.heard(id);
        if !matches!(frame.unit, 0 | 1 | 255) {
            continue;
        }
        let (response, not_owner) = reply(shared, id, &frame);
        if not_owner && told.is_none_or(|t| t.elapsed() > TELL) {
            told = Some(Instant::now());
            tracing::warn!(%address, "a write by who does not own the command block was refused");
        }
        match tokio::time::timeout(WRITE, stream.write_all(&response)).await {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return tracing::info!(%address, "writing failed: {e}"),
            Err(_) => return tracing::warn!(%address, "does not read its responses"),
        }
        tokio::task::yield_now().await; // one frame each in turn, however many a client sends at once
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    fn shared() -> Arc<Shared> {
        let settings =
            Settings { heartbeat_timeout: Duration::from_secs(3), presence: false, word_order: WordOrder::HighFirst };
        let (orders, _) = mpsc::sync_channel(1);
        Arc::new(Shared::new(Handshake::new(settings, Identity::default()), orders))
    }

    #[test]
    fn a_task_that_panics_is_begun_again_and_a_connection_that_panics_is_taken_off_the_list() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
        runtime.block_on(async {
            let shared = shared();
            let leave = Leave { shared: shared.clone(), id: 1 };
            let task = tokio::spawn(async move {
                let _leave = leave;
                panic!("planted");
            });
            shared.join(1, SocketAddr::from(([127, 0, 0, 1], 9)), task.abort_handle());
            assert!(shared.write(1, 0, &[1]).is_ok() && shared.view().owner.is_some());
            assert!(task.await.is_err());
            assert_eq!(shared.view(), View::default());
            let (tell, mut told) = tokio::sync::mpsc::unbounded_channel();
            let mut times = 0;
            let twice = || {
                times += 1;
                let (tell, times) = (tell.clone(), times);
                async move {
                    assert!(times > 1, "planted");
                    tell.send(times).expect("the test is there");
                    std::future::pending::<()>().await;
                }
            };
            tokio::select! {
                () = forever("testing", twice) => {}
                times = told.recv() => assert_eq!(times, Some(2)),
            }
        });
    }

    #[test]
    fn a_panic_at_a_report_leaves_the_handshake_to_the_others() {
        let shared = shared();
        survive("a test", || shared.panic_under_the_lock());
        shared.step(Event::Beat);
        assert_eq!(shared.newest().input(1, 1).expect("DEVICE_HEARTBEAT"), [1]);
    }
}
