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
use datum::hal::Sensor;
use datum::image::Image;
use datum::sim::{Layers, Lit, Picture, Random, Scene, Setup, Take, expose};
use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Images on either cable, per second.
const PROJECTOR_FPS: u64 = 60;
const CAMERA_FPS: u64 = 100;
/// Where the body is lit the projector is about as far away as the camera, mm.
const FAR: f64 = datum::sim::DISTANCE_MM;
/// Different pictures that are kept ready.
const PICTURES: usize = 32;
/// What each image showed is kept for so many.
const LOG: usize = 4096;
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
        let thread = std::thread::Builder::new().name("player".into()).spawn(move || playing.play())?;
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
        let (setup, shared) = (Arc::clone(setup), Arc::clone(shared));
        let random = Random::new(seed, &[0x706c_6179]);
        Ok(Self { setup, shared, seed, random, projected, camera, pictures: VecDeque::new(), image })
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
            if self.expose(&layers, number, broken)? {
                continue;
            }
            lock(&self.shared).images -= 1;
        }
    }

    /// One image; false: there was nothing to see in a second.
    fn expose(&mut self, layers: &Layers, number: u64, broken: f64) -> io::Result<bool> {
        // all that was shown while the last image was rendered is past
        while let Some(given) = self.projected.dequeue()? {
            self.projected.queue(given.index, Duration::ZERO)?;
        }
        let Some(given) = self.projected.next(Duration::from_secs(1))? else { return Ok(false) };
        let stamp = given.stamp;
        let bars = pins::bars()?;
        let time = Duration::from_micros(100) * self.camera.node.control(control::EXPOSURE)?.unsigned_abs();
        let gain = f64::from(self.camera.node.control(control::GAIN)?) / 16.0;
        let at = self.shown(given.index);
        self.projected.queue(given.index, Duration::ZERO)?;
        let (_, picture, light) = &self.pictures[at];
        let lit = Lit { bars, ambient: 1.0, picture: light.as_ref() };
        let take = Take { exposure: time, gain, seed: self.seed, number };
        expose(&self.setup, layers, &lit, None, &take, &mut self.image);
        let picture = light.as_ref().map(|_| *picture);

        let index = self.camera.free()?;
        let bytes = self.camera.exposed.bytes(index);
        let image = if self.setup.sensor.bits == 8 {
            bytes.iter_mut().zip(&self.image.pixels).for_each(|(b, v)| *b = *v as u8);
            digest(&bytes[..self.image.pixels.len()])
        } else {
            for (b, v) in bytes.chunks_exact_mut(2).zip(&self.image.pixels) {
                b.copy_from_slice(&v.to_le_bytes());
            }
            digest(&bytes[..2 * self.image.pixels.len()])
        };
        if broken > 0.0 && self.random.uniform() < broken {
            self.camera.exposed.set_control(control::BROKEN, 1)?;
        }
        let mut shared = lock(&self.shared);
        if shared.log.len() == LOG {
            shared.log.pop_front();
        }
        shared.log.push_back(Showed { image, picture, bars });
        drop(shared);
        self.camera.exposed.queue(index, stamp)?;
        Ok(true)
    }

    /// The place in `pictures` of what that buffer shows.
    fn shown(&mut self, index: u32) -> usize {
        let pixels = self.setup.rig.projector.width * self.setup.rig.projector.height;
        let bytes = &self.projected.bytes(index)[..pixels];
        if let Some(at) = self.pictures.iter().position(|(known, ..)| known == bytes) {
            return at;
        }
        if self.pictures.len() == PICTURES {
            self.pictures.pop_front();
        }
        let bytes = bytes.to_vec();
        let dark = bytes.iter().all(|v| *v <= BLACK);
        let light = (!dark).then(|| {
            let lens = &self.setup.rig.projector;
            let image = Image { width: lens.width, height: lens.height, pixels: bytes.clone() };
            Picture::new(&image, &self.setup, FAR)
        });
        let id = digest(&bytes);
        self.pictures.push_back((bytes, id, light));
        self.pictures.len() - 1
    }

    /// Takes the camera away, for `away` and until nobody has it open any more.
    fn unplug(&mut self, away: Duration) -> io::Result<()> {
        self.camera.exposed.set_control(control::DISCONNECT, 1)?;
        std::thread::sleep(away);
        // the nodes come back when the last one of us closes them, and a driver may be slower than we are
        self.camera.exposed = Node::open(Path::new("/dev/null"), Side::Output)?;
        self.camera.node = Node::open(Path::new("/dev/null"), Side::Capture)?;
        loop {
            match Camera::open(&self.setup.sensor) {
                Ok(camera) => self.camera = camera,
                Err(_) => {
                    std::thread::sleep(Duration::from_millis(20));
                    continue;
                }
            }
            lock(&self.shared).returned += 1;
            return Ok(());
        }
    }
}
