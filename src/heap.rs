//! The heap of a process that runs for months. In: nothing. Out: one setting of the C library's allocator.

/// Lists of this size and more are mapped for themselves and given back to the system when dropped. By itself glibc moves
/// this bound up to the largest list that was ever dropped (32 MiB at most), and then keeps what lies between lists of
/// other sizes: at ten jobs resident memory was half as much again as what was in use, and grew for thousands of vehicles.
#[cfg(target_env = "gnu")]
const MAPPED_BYTES: i32 = 1 << 20;

/// Keeps resident memory near what is in use.
#[cfg(target_env = "gnu")]
pub fn steady() {
    #[expect(unsafe_code, reason = "mallopt has no safe form")]
    // SAFETY: it takes two numbers, and changes how memory is found from now on; what is in use stays.
    let set = unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED_BYTES) };
    debug_assert_eq!(set, 1, "mallopt");
}

/// Keeps resident memory near what is in use: other C libraries do.
#[cfg(not(target_env = "gnu"))]
pub fn steady() {}
