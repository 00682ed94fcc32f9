//! The scene player: the world between a projector's node and a camera's. A thread takes what the projector shows, renders
//! the scene that it falls on with the simulated station's own renderer, lit by the bars as lines and PWM say, and gives
//! it to the camera's node, again and again.
//! In:  a setup, scenes, faults. Out: images on the camera's node; what each of them showed.
//! Not here: what a camera's driver makes of it. A projector that shows nothing but black counts as dark: real ones turn
//! their lamp off.
//!
//! An image carries the time at which the projector was looked at; bars and controls are read right after it. So nothing
//! in it is older than its time stamp.

use crate::pins;
use crate::v4l2::{Node, Side, control};
use datum::capture::{SETS, pictures};
use datum::hal::Sensor;
use datum::image::Image;
use datum::sim::{Layers, Lit, Picture, Random, Scene, Setup, Take, expose};
use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Images on either cable, per second.
const PROJECTOR_FPS: u64 = 60;
const CAMERA_FPS: u64 = 100;
/// At least so long from one image to the next.
const BETWEEN: Duration = Duration::from_millis(14);
/// Where the body is lit the projector is about as far away as the camera, mm.
const FAR: f64 = datum::sim::DISTANCE_MM;
/// Different pictures that are kept ready.
const PICTURES: usize = 32;
/// What each image showed is kept for so many.
const LOG: usize = 4096;
/// While nothing changes so many images are rendered, each with noise of its own; then they come again, in turn: rendering
/// is dear in the guest, and a station that waits or computes does not look.
const DIFFERENT: usize = 3;
/// Grey levels up to this are black, if the whole picture has them: vivid's own black has 16.
const BLACK: u8 = 16;

/// What an image showed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Showed {
    /// Of the image's pixels.
    pub(crate) image: u64,
    /// Of the picture that the projector showed; `None`: dark.
    pub(crate) picture: Option<u64>,
    /// Light of the bars.
    pub(crate) bars: [f64; 2],
}

/// Identifies an image by its pixels.
pub(crate) fn digest(pixels: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    pixels.hash(&mut hasher);
    hasher.finish()
}

struct Shared {
    layers: Arc<Layers>,
    log: VecDeque<Showed>,
    /// Share of images that are marked as broken.
    broken: f64,
    /// How long the camera stays away, once it is unplugged.
    unplugged: Option<Duration>,
    /// Times it came back.
    returned: usize,
    images: u64,
    end: bool,
}

/// The world before the station.
pub(crate) struct Player {
    setup: Arc<Setup>,
    shared: Arc<Mutex<Shared>>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl Player {
    /// Begins to play, with nothing before the station.
    pub(crate) fn start(setup: &Arc<Setup>, seed: u64) -> io::Result<Self> {
        let shared = Shared {
            layers: Arc::new(Layers::empty(setup)),
            log: VecDeque::new(),
            broken: 0.0,
            unplugged: None,
            returned: 0,
            images: 0,
            end: false,
        };
        let shared = Arc::new(Mutex::new(shared));
        let mut playing = Playing::new(setup, &shared, seed)?;
        pins::pull(pins::PRESENCE, false)?;
        let thread = std::thread::Builder::new().name("player".into()).spawn(move || {
            // told at once: what waits for images would wait in vain
            playing.play().inspect_err(|e| eprintln!("the scene player ended: {e}"))
        })?;
        Ok(Self { setup: Arc::clone(setup), shared, thread: Some(thread) })
    }

    fn shared(&self) -> MutexGuard<'_, Shared> {
        lock(&self.shared)
    }

    /// A vehicle stands there, and the sensor says so.
    pub(crate) fn bring(&self, scene: &Scene) -> io::Result<()> {
        let layers = Arc::new(Layers::new(scene, &self.setup, 0.0));
        self.shared().layers = layers;
        pins::pull(pins::PRESENCE, true)
    }

    /// Nothing stands there any more.
    pub(crate) fn leave(&self) -> io::Result<()> {
        pins::pull(pins::PRESENCE, false)?;
        self.shared().layers = Arc::new(Layers::empty(&self.setup));
        Ok(())
    }

    /// That share of the images is marked as broken from now on.
    pub(crate) fn break_images(&self, share: f64) {
        self.shared().broken = share;
    }

    /// That percentage of the images is lost from now on.
    pub(crate) fn drop_images(&self, percent: i32) -> io::Result<()> {
        Node::open(Path::new(CAMERA), Side::Capture)?.set_control(control::DROPPED, percent)
    }

    /// The camera is gone for so long, at least: it is back when its driver has closed it, too.
    pub(crate) fn unplug(&self, away: Duration) {
        self.shared().unplugged = Some(away);
    }

    /// Times that the camera has come back.
    pub(crate) fn returned(&self) -> usize {
        self.shared().returned
    }

    /// What the latest images showed, the oldest first.
    pub(crate) fn showed(&self) -> Vec<Showed> {
        self.shared().log.iter().cloned().collect()
    }

    /// Images given so far.
    pub(crate) fn images(&self) -> u64 {
        self.shared().images
    }

    /// Ends; what went wrong, if something did.
    pub(crate) fn end(mut self) -> io::Result<()> {
        self.shared().end = true;
        self.thread.take().map_or(Ok(()), |t| t.join().unwrap_or_else(|_| Err(io::Error::other("the player panicked"))))
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

const PROJECTOR: &str = "/dev/datum/projector";
const PROJECTED: &str = "/dev/datum/projected";
const CAMERA: &str = "/dev/datum/camera";
const EXPOSED: &str = "/dev/datum/exposed";

struct Playing {
    setup: Arc<Setup>,
    shared: Arc<Mutex<Shared>>,
    seed: u64,
    random: Random,
    projected: Node,
    camera: Camera,
    pictures: VecDeque<(Vec<u8>, u64, Option<Picture>)>,
    image: Image<u16>,
    /// What the images in `rendered` show, and how many times one was given.
    view: Option<View>,
    rendered: Vec<Vec<u8>>,
    given: usize,
    queued: Instant,
}

/// All that an image depends on, but for noise.
#[derive(Clone, PartialEq)]
struct View {
    picture: Option<u64>,
    bars: [f64; 2],
    time: Duration,
    gain: f64,
    /// Where the scene's light lies in memory: kept, so that no other one lies there.
    layers: Kept,
}

#[derive(Clone)]
struct Kept(Arc<Layers>);

impl PartialEq for Kept {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Both ends of the camera's cable: the one that datum opens is read for its controls.
struct Camera {
    node: Node,
    exposed: Node,
    free: Vec<u32>,
}

impl Camera {
    fn open(sensor: &Sensor) -> io::Result<Self> {
        let size = (sensor.width, sensor.height);
        let format = if sensor.bits == 8 { *b"GREY" } else { *b"Y10 " };
        let node = Node::open(Path::new(CAMERA), Side::Capture)?;
        let mut exposed = Node::open(Path::new(EXPOSED), Side::Output)?;
        loop_back(&node)?;
        // a driver may have it already
        if node.set_timings(size, CAMERA_FPS).and_then(|()| node.set_format(size, format)).is_err() {
            eprintln!("player: the camera's node is in use; its size and format are left as they are");
        }
        exposed.set_timings(size, CAMERA_FPS)?;
        exposed.set_format(size, format)?;
        exposed.start(4)?;
        let free = (0..exposed.count()).collect();
        Ok(Self { node, exposed, free })
    }

    fn free(&mut self) -> io::Result<u32> {
        loop {
            while let Some(given) = self.exposed.dequeue()? {
                self.free.push(given.index);
            }
            match self.free.pop() {
                Some(index) => return Ok(index),
                None => drop(self.exposed.next(Duration::from_secs(1))?.map(|g| self.free.push(g.index))),
            }
        }
    }
}

fn loop_back(node: &Node) -> io::Result<()> {
    for (id, value) in
        [(control::TEST_PATTERN, 5), (control::TEXT, 2), (control::STAMP_AT_BEGIN, 1), (control::LOOP, 1)]
    {
        node.set_control(id, value)?;
    }
    Ok(())
}

impl Playing {
    fn new(setup: &Arc<Setup>, shared: &Arc<Mutex<Shared>>, seed: u64) -> io::Result<Self> {
        let lens = &setup.rig.projector;
        let size = (lens.width, lens.height);
        let mut projected = Node::open(Path::new(PROJECTED), Side::Capture)?;
        loop_back(&projected)?;
        projected.set_timings(size, PROJECTOR_FPS)?;
        projected.set_format(size, *b"GREY")?;
        let projector = Node::open(Path::new(PROJECTOR), Side::Output)?;
        projector.set_timings(size, PROJECTOR_FPS)?;
        projector.set_format(size, *b"GREY")?;
        projected.start(2)?;
        let camera = Camera::open(&setup.sensor)?;
        let image = Image::filled(setup.sensor.width, setup.sensor.height, 0);
        let mut new = Self {
            setup: Arc::clone(setup),
            shared: Arc::clone(shared),
            seed,
            random: Random::new(seed, &[0x706c_6179]),
            projected,
            camera,
            pictures: VecDeque::new(),
            image,
            view: None,
            rendered: Vec::new(),
            given: 0,
            queued: Instant::now(),
        };
        // what a station shows, so that no image waits for it
        for picture in pictures(&SETS, lens.width, lens.height).map_err(io::Error::other)? {
            new.know(picture.pixels);
        }
        Ok(new)
    }

    fn play(&mut self) -> io::Result<()> {
        loop {
            let (layers, broken, unplugged, number) = {
                let mut shared = lock(&self.shared);
                if shared.end {
                    return Ok(());
                }
                shared.images += 1;
                (Arc::clone(&shared.layers), shared.broken, shared.unplugged.take(), shared.images)
            };
            if let Some(away) = unplugged {
                self.unplug(away)?;
            }
            if self.expose(layers, number, broken)? {
                continue;
            }
            lock(&self.shared).images -= 1;
        }
    }

    /// One image; false: there was nothing to see in a second.
    fn expose(&mut self, layers: Arc<Layers>, number: u64, broken: f64) -> io::Result<bool> {
        // all that was shown while the last image was rendered is past
        while let Some(given) = self.projected.dequeue()? {
            self.projected.queue(given.index, Duration::ZERO)?;
        }
        let Some(given) = self.projected.next(Duration::from_secs(1))? else { return Ok(false) };
        let bars = pins::bars()?;
        let time = Duration::from_micros(100) * self.camera.node.control(control::EXPOSURE)?.unsigned_abs();
        let gain = f64::from(self.camera.node.control(control::GAIN)?) / 16.0;
        let at = self.shown(given.index);
        self.projected.queue(given.index, Duration::ZERO)?;
        let picture = self.pictures[at].2.as_ref().map(|_| self.pictures[at].1);
        let view = View { picture, bars, time, gain, layers: Kept(layers) };
        if self.view.as_ref() != Some(&view) {
            self.view = Some(view.clone());
            self.rendered.clear();
            self.given = 0;
        }
        if self.rendered.len() < DIFFERENT {
            let bytes = self.render(&view, at, number);
            let mut shared = lock(&self.shared);
            if shared.log.len() == LOG {
                shared.log.pop_front();
            }
            shared.log.push_back(Showed { image: digest(&bytes), picture, bars });
            drop(shared);
            self.rendered.push(bytes);
        }
        let bytes = &self.rendered[self.given % self.rendered.len()];
        self.given += 1;
        let index = self.camera.free()?;
        self.camera.exposed.bytes(index)[..bytes.len()].copy_from_slice(bytes);
        if broken > 0.0 && self.random.uniform() < broken {
            self.camera.exposed.set_control(control::BROKEN, 1)?;
        }
        // the camera's node looks once in 10 ms, and takes the newest image only
        std::thread::sleep(BETWEEN.saturating_sub(self.queued.elapsed()));
        self.camera.exposed.queue(index, given.stamp)?;
        self.queued = Instant::now();
        Ok(true)
    }

    /// An image as the camera's node takes it.
    fn render(&mut self, view: &View, picture: usize, number: u64) -> Vec<u8> {
        let lit = Lit { bars: view.bars, ambient: 1.0, picture: self.pictures[picture].2.as_ref() };
        let take = Take { exposure: view.time, gain: view.gain, seed: self.seed, number };
        expose(&self.setup, &view.layers.0, &lit, None, &take, &mut self.image);
        let samples = self.image.pixels.iter();
        if self.setup.sensor.bits == 8 {
            samples.map(|v| *v as u8).collect()
        } else {
            samples.flat_map(|v| v.to_le_bytes()).collect()
        }
    }

    /// The place in `pictures` of what that buffer shows.
    fn shown(&mut self, index: u32) -> usize {
        let pixels = self.setup.rig.projector.width * self.setup.rig.projector.height;
        let bytes = &self.projected.bytes(index)[..pixels];
        if let Some(at) = self.pictures.iter().position(|(known, ..)| known == bytes) {
            return at;
        }
        let bytes = bytes.to_vec();
        self.know(bytes);
        self.pictures.len() - 1
    }

    /// Keeps a picture ready, as the last one.
    fn know(&mut self, bytes: Vec<u8>) {
        if self.pictures.len() == PICTURES {
            self.pictures.pop_front();
        }
        let dark = bytes.iter().all(|v| *v <= BLACK);
        let light = (!dark).then(|| {
            let lens = &self.setup.rig.projector;
            let image = Image { width: lens.width, height: lens.height, pixels: bytes.clone() };
            Picture::new(&image, &self.setup, FAR)
        });
        let id = digest(&bytes);
        self.pictures.push_back((bytes, id, light));
    }

    /// Takes the camera away, for `away` and until nobody has it open any more.
    fn unplug(&mut self, away: Duration) -> io::Result<()> {
        self.camera.exposed.set_control(control::DISCONNECT, 1)?;
        std::thread::sleep(away);
        // the nodes come back when the last one who has them open closes them, and a driver may be slower than we are
        let nowhere = Path::new("/dev/null");
        self.camera.exposed = Node::open(nowhere, Side::Output)?;
        self.camera.node = Node::open(nowhere, Side::Capture)?;
        self.camera = loop {
            match Camera::open(&self.setup.sensor) {
                Ok(camera) => break camera,
                Err(_) => std::thread::sleep(Duration::from_millis(20)),
            }
        };
        lock(&self.shared).returned += 1;
        Ok(())
    }
}
