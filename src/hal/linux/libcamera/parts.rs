//! Whether a camera's parts are still attached. In: the device numbers that libcamera names. Out: whether the kernel has them.

use super::super::Sys;

/// Whether one of the device numbers is no longer there; of none nobody can say.
pub(super) fn missing(sys: &Sys, devices: &[i64]) -> bool {
    devices.iter().any(|device| {
        let device = device.cast_unsigned();
        let name = format!("{}:{}", rustix::fs::major(device), rustix::fs::minor(device));
        !sys.0.join("dev/char").join(name).exists()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_whole_while_the_kernel_has_each_of_its_devices() {
        let root = std::env::temp_dir().join(format!("datum-parts-{}", std::process::id()));
        for name in ["81:4", "81:300"] {
            std::fs::create_dir_all(root.join("dev/char").join(name)).expect("writable");
        }
        let sys = Sys(root.clone());
        let number = |minor: u32| rustix::fs::makedev(81, minor).cast_signed();
        assert!(!missing(&sys, &[number(4), number(300)]) && !missing(&sys, &[]));
        assert!(missing(&sys, &[number(4), number(5)]));
        std::fs::remove_dir_all(root).expect("just made");
    }
}
