//! Memory that is used again. In: lists and images that are done with. Out: empty ones with the room of those.
//! Not here: what they hold.
//!
//! A measurement makes some thousand lists: edges, samples, cells, of each feature in each pass. An allocator asked for
//! each of them takes its time, and scatters the heap of a process that runs for months. So a task is served by a
//! [`Spare`]: a [`List`] that is made while the task runs takes the room of one before it, and gives it back when it is
//! dropped. Elsewhere it is a `Vec`.
//!
//! Room comes back to the line of source that made the list, which takes the first that is free; and of tasks that run side
//! by side each thread's share has a `Spare` of its own ([`side_by_side`]). So, on any number of threads, the same once more
//! gets the same room for each of its lists, and needs no more.

use rayon::prelude::*;
use std::any::Any;
use std::cell::RefCell;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::panic::Location;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Room for what a task makes. Clones share it.
#[derive(Clone, Default)]
pub struct Spare(Arc<Mutex<Kept>>);

#[derive(Default)]
struct Kept {
    /// By the line that makes them: a `Vec<Option<_>>` of what there is, without what is lent.
    by_place: Vec<(Place, Box<dyn Any + Send>)>,
    /// Of the shares of tasks that run side by side inside this one.
    shares: Vec<Spare>,
}

type Place = &'static Location<'static>;

thread_local! {
    /// What serves the task that runs on this thread.
    static SERVING: RefCell<Option<Spare>> = const { RefCell::new(None) };
}

impl Spare {
    /// Serves `task`: what it makes on this thread takes its room from here.
    pub fn serve<R>(&self, task: impl FnOnce() -> R) -> R {
        struct Before(Option<Spare>);
        impl Drop for Before {
            fn drop(&mut self) {
                SERVING.set(self.0.take());
            }
        }
        let _restored = Before(SERVING.replace(Some(self.clone())));
        task()
    }

    /// That of share `k` of tasks that run side by side.
    fn share(&self, k: usize) -> Self {
        let mut kept = self.kept();
        let n = kept.shares.len().max(k + 1);
        kept.shares.resize_with(n, Self::default);
        kept.shares[k].clone()
    }

    /// The first room that `place` is not using, or none with its number.
    fn take<C: Reuse>(&self, place: Place) -> (usize, Option<C>) {
        let mut kept = self.kept();
        let rooms = kept.rooms(place);
        let k = rooms.iter().position(Option::is_some).unwrap_or(rooms.len());
        if k == rooms.len() {
            rooms.push(None);
        }
        (k, rooms[k].take())
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn rooms<C: Reuse>(&mut self, place: Place) -> &mut Vec<Option<C>> {
        let same =
            |(at, rooms): &(Place, Box<dyn Any + Send>)| std::ptr::eq(*at, place) && rooms.is::<Vec<Option<C>>>();
        let k = self.by_place.iter().position(same).unwrap_or_else(|| {
            self.by_place.push((place, Box::new(Vec::<Option<C>>::new())));
            self.by_place.len() - 1
        });
        self.by_place[k].1.downcast_mut().expect("of that type, as it was looked for")
    }
}

/// Does `task` for 0..`n`, as many at once as there are threads. Their results in order.
///
/// Every thread has a share of them that depends on nothing but their number: which thread is the first to be done differs
/// from run to run, and with it would the room that each needs.
#[track_caller]
pub fn side_by_side<R: Send + 'static>(n: usize, task: impl Fn(usize) -> R + Sync) -> List<R> {
    let spare = SERVING.with_borrow(|spare| spare.clone().unwrap_or_default());
    let threads = rayon::current_num_threads().min(n);
    let backwards = |share: usize| List::of((share..n).step_by(threads).rev().map(&task));
    let shares = (0..threads).into_par_iter().map(|k| spare.share(k).serve(|| backwards(k)));
    let mut done = List::of_parallel(shares);
    List::of((0..n).map(|k| done[k % threads].pop().expect("one of each task")))
}

/// What can be used again.
pub trait Reuse: Default + Send + 'static {
    /// Whether what it holds must be dropped once it is done with.
    const MUST_DROP: bool;

    /// Empties it and leaves it its room.
    fn empty(&mut self);
}

impl<T: Send + 'static> Reuse for Vec<T> {
    const MUST_DROP: bool = std::mem::needs_drop::<T>();

    fn empty(&mut self) {
        self.clear();
    }
}

/// A `C` whose room is given back when it is dropped.
pub struct Lent<C: Reuse> {
    content: C,
    /// Where it is given back to.
    from: Option<(Spare, Place, usize)>,
}

/// A list whose room is given back when it is dropped.
pub type List<T> = Lent<Vec<T>>;

impl<C: Reuse> Lent<C> {
    /// An empty one.
    #[track_caller]
    pub fn new() -> Self {
        let mut new = Self::as_left(Location::caller());
        new.empty();
        new
    }

    /// With what one before it held, unless that had to be dropped.
    fn as_left(place: Place) -> Self {
        let Some(spare) = SERVING.with_borrow(Option::clone) else {
            return Self { content: C::default(), from: None };
        };
        let (k, left) = spare.take(place);
        Self { content: left.unwrap_or_default(), from: Some((spare, place, k)) }
    }
}

impl<T: Send + 'static> List<T> {
    /// Of `values`.
    #[track_caller]
    pub fn of(values: impl IntoIterator<Item = T>) -> Self {
        let mut list = Self::new();
        list.extend(values);
        list
    }

    /// Of `values`, found in parallel; what they are made with on other threads is not served.
    #[track_caller]
    pub fn of_parallel(values: impl IndexedParallelIterator<Item = T>) -> Self {
        let mut list = Self::new();
        values.collect_into_vec(&mut list);
        list
    }

    /// Of `n` times `value`.
    #[track_caller]
    pub fn filled(value: T, n: usize) -> Self
    where
        T: Clone,
    {
        let mut list = Self::new();
        list.resize(n, value);
        list
    }

    /// Of `n` values to be overwritten: `value`, or whatever was in the room.
    #[track_caller]
    pub fn stale(value: T, n: usize) -> Self
    where
        T: Copy,
    {
        let mut list = Self::as_left(Location::caller());
        list.resize(n, value);
        list
    }
}

impl<C: Reuse> Drop for Lent<C> {
    fn drop(&mut self) {
        if let Some((spare, place, k)) = self.from.take() {
            let mut content = std::mem::take(&mut self.content);
            if C::MUST_DROP {
                content.empty(); // before we ask for the lock: what it holds may give back, too
            }
            spare.kept().rooms(place)[k] = Some(content);
        }
    }
}

impl<C: Reuse> Deref for Lent<C> {
    type Target = C;

    fn deref(&self) -> &C {
        &self.content
    }
}

impl<C: Reuse> DerefMut for Lent<C> {
    fn deref_mut(&mut self) -> &mut C {
        &mut self.content
    }
}

impl<C: Reuse> Default for Lent<C> {
    #[track_caller]
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Clone + Send + 'static> Clone for List<T> {
    #[track_caller]
    fn clone(&self) -> Self {
        Self::of(self.iter().cloned())
    }
}

impl<C: Reuse + fmt::Debug> fmt::Debug for Lent<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.content.fmt(f)
    }
}

impl<C: Reuse + PartialEq> PartialEq for Lent<C> {
    fn eq(&self, other: &Self) -> bool {
        self.content == other.content
    }
}

impl<'a, C: Reuse> IntoIterator for &'a Lent<C>
where
    &'a C: IntoIterator,
{
    type Item = <&'a C as IntoIterator>::Item;
    type IntoIter = <&'a C as IntoIterator>::IntoIter;

    fn into_iter(self) -> Self::IntoIter {
        (&self.content).into_iter()
    }
}

impl<'a, C: Reuse> IntoIterator for &'a mut Lent<C>
where
    &'a mut C: IntoIterator,
{
    type Item = <&'a mut C as IntoIterator>::Item;
    type IntoIter = <&'a mut C as IntoIterator>::IntoIter;

    fn into_iter(self) -> Self::IntoIter {
        (&mut self.content).into_iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lists of `n` and 3 values at once, the second inside the first's life; the first's room and where it is.
    fn task(n: usize) -> (usize, usize) {
        let first = List::of(0..n as u32);
        let second = List::of(0..3u32);
        assert!(first.len() == n && second.len() == 3);
        (first.capacity(), first.as_ptr() as usize)
    }

    #[test]
    fn a_task_that_runs_again_finds_the_room_it_left_and_another_does_not() {
        let (spare, other) = (Spare::default(), Spare::default());
        let (room, at) = spare.serve(|| task(1000));
        assert_eq!(spare.serve(|| task(900)), (room, at));
        assert_ne!(other.serve(|| task(900)).1, at);
        assert_eq!(spare.serve(|| List::<u32>::new().capacity()), 0, "a list of another line");
        assert_eq!(List::<u32>::new().capacity(), 0, "no task");
    }

    #[test]
    fn tasks_side_by_side_find_the_room_they_left_on_any_number_of_threads() {
        for threads in [1, 2, 3, 20, 30] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let spare = Spare::default();
            let all = || pool.install(|| spare.serve(|| side_by_side(20, |k| (k, task(10 * k + 10))).to_vec()));
            all(); // lists have grown to what their share needs
            let (first, again) = (all(), all());
            assert!(first.iter().map(|(k, _)| *k).eq(0..20), "in order");
            assert_eq!(first, again);
            let places: std::collections::BTreeSet<_> = first.into_iter().map(|(_, (_, at))| at).collect();
            assert_eq!(places.len(), threads.min(20));
        }
        assert!(side_by_side(0, |k| k).is_empty());
    }

    #[test]
    fn lists_that_are_dropped_in_another_order_get_the_same_room_again() {
        let spare = Spare::default();
        let room = || {
            spare.serve(|| {
                let mut lists = [10, 1000, 100].map(|n| List::of(0..n));
                let room = [0, 1, 2].map(|k| lists[k].capacity());
                lists.rotate_left(1);
                room
            })
        };
        assert_eq!(room(), room());
    }

    #[test]
    fn what_a_list_holds_is_dropped_with_it_and_gives_back_its_own_room() {
        let spare = Spare::default();
        let nested =
            |n: usize| spare.serve(|| List::of((0..n).map(|_| task(5).0)).len() + List::of([List::of(0..7u8)]).len());
        assert_eq!((nested(4), nested(4)), (5, 5));
        let value = Arc::new(());
        drop(spare.serve(|| List::of([value.clone(), value.clone()])));
        assert_eq!(Arc::strong_count(&value), 1);
    }
}
