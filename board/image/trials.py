#!/usr/bin/env python3
"""What the image must show, in qemu-system-aarch64: each trial ends with an error where it does not hold.

    trials.py OUT boot|memory|update|bad|install-cuts|measure-cuts [N]

OUT is the folder of board/image/build for qemu-virt, with the bundles that board/test made. No KVM: everything is emulated,
so times say nothing about a real board. A power cut is a SIGKILL of qemu: what the guest handed to its card is on it, what it
held back is lost; a card that loses what it had acknowledged is not simulated.
"""
import json
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import time

READY, FAULT = 1, 8
SERVICE = "datum.service"


class Failed(Exception):
    pass


def must(ok, said):
    if not ok:
        raise Failed(said)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Guest:
    """An appliance on a card: powered on, spoken to at its console and by Modbus, powered off or cut."""

    def __init__(self, out, card, stick=None):
        self.out, self.card, self.stick = out, card, stick
        self.process = None
        self.log = open(card + ".console", "ab")

    def power_on(self):
        self.port = free_port()
        console = self.card + ".socket"
        if os.path.exists(console):
            os.unlink(console)
        command = ["qemu-system-aarch64", "-M", "virt", "-cpu", "cortex-a72", "-smp", "2", "-m", "2G", "-accel", "tcg,thread=multi",
                   "-nodefaults", "-display", "none", "-bios", f"{self.out}/u-boot.bin",
                   "-device", "sdhci-pci,sd-spec-version=3",
                   "-drive", f"if=none,file={self.card},format=raw,id=card", "-device", "sd-card,drive=card",
                   "-device", "i6300esb", "-action", "watchdog=reset",
                   "-netdev", f"user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:{self.port}-:502",
                   "-device", "virtio-net-pci,netdev=net,romfile=",
                   "-serial", f"unix:{console},server=on,wait=off"]
        if self.stick:
            command += ["-drive", f"if=none,file={self.stick},format=raw,readonly=on,id=stick", "-device", "qemu-xhci",
                        "-device", "usb-storage,drive=stick"]
        self.process = subprocess.Popen(command)
        self.begun = time.monotonic()
        for _ in range(100):
            try:
                self.console = socket.socket(socket.AF_UNIX)
                self.console.connect(console)
                break
            except OSError:
                time.sleep(0.1)
        self.console.settimeout(1)
        self.text = ""

    def age(self):
        return time.monotonic() - self.begun

    def read(self):
        try:
            data = self.console.recv(65536)
        except socket.timeout:
            return
        except OSError:
            data = b""
        must(data or self.process.poll() is None, "qemu has ended")
        if not data:
            time.sleep(0.2)
        self.log.write(data)
        self.log.flush()
        self.text += data.decode(errors="replace")

    def until(self, pattern, seconds):
        """Waits until the console shows it; what came before is taken off."""
        end = time.monotonic() + seconds
        while True:
            found = re.search(pattern, self.text)
            if found:
                self.text = self.text[found.end():]
                return found
            must(time.monotonic() < end, f"not within {seconds} s on the console: {pattern!r}; it ends with {self.text[-2000:]!r}")
            self.read()

    def shell(self, seconds=600):
        self.until(r"root@[^\n]*# ", seconds)
        self.console.sendall(b"stty -echo cols 500; bind 'set enable-bracketed-paste off'; export PAGER=cat SYSTEMD_COLORS=0; PS1=; dmesg -n 1\n")
        self.run("true", 120)

    def run(self, command, seconds=300):
        """Output and exit status of a command at the console."""
        token = f"{random.getrandbits(48):x}"
        self.console.sendall(f"echo A-{token}; {command}\necho B-{token} $?\n".encode())
        self.until(rf"A-{token}\r?\n", seconds)
        end = time.monotonic() + seconds
        while not (found := re.search(rf"(?s)(.*?)B-{token} (\d+)\r?\n", self.text)):
            must(time.monotonic() < end, f"{command!r} takes more than {seconds} s: {self.text[-2000:]!r}")
            self.read()
        self.text = self.text[found.end():]
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "", found[1]), int(found[2])

    def ok(self, command, seconds=300):
        said, status = self.run(command, seconds)
        must(status == 0, f"{command}: exit status {status}: {said}")
        return said.strip()

    def registers(self, address, count):
        """Input registers over Modbus TCP; None while nobody answers."""
        try:
            with socket.create_connection(("127.0.0.1", self.port), 5) as s:
                s.settimeout(5)
                s.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, address, count))
                answer = b""
                while len(answer) < 9 + 2 * count:
                    part = s.recv(1024)
                    if not part:
                        return None
                    answer += part
                return struct.unpack(f">{count}H", answer[9:9 + 2 * count]) if answer[7] == 4 else None
        except OSError:
            return None

    def ready(self, seconds):
        """Waits for READY in STATUS, as a PLC does; the time since power-on."""
        end = time.monotonic() + seconds
        last = None
        while time.monotonic() < end:
            must(self.process.poll() is None, "qemu has ended")
            last = self.registers(0, 5) or last
            if last and last[0] & READY:
                return self.age()
            self.read()
        raise Failed(f"not READY within {seconds} s: registers 0 to 4 {last}; console {self.text[-1500:]!r}")

    def cut(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.console.close()

    def power_off(self):
        self.console.sendall(b"systemctl poweroff\n")
        try:
            self.process.wait(180)
        except subprocess.TimeoutExpired:
            self.cut()
            raise Failed("does not power off within 180 s")
        self.console.close()

    def slot(self):
        return re.search(r"rauc\.slot=(\w)", self.ok("cat /proc/cmdline"))[1]

    def records(self):
        """Records by their ids, as the appliance lists them; damage before the last one is a failure."""
        said = self.ok("cd /data/datum && datum records list --json --folder records 2>/tmp/said | "
                       "tr ',' '\\n' | grep '\"record\"' | tr -dc '0-9\\n' | tr '\\n' ' '")
        return [int(n) for n in said.split()], self.ok("cat /tmp/said")


def new_card(out, name, scale="0.25", size=2 << 30):
    """A flashed card whose station is small enough to be emulated: only the scale of the simulated camera differs."""
    card = f"{out}/{name}.img"
    subprocess.run(["cp", "--sparse=always", f"{out}/datum.img", card], check=True)
    with open(card, "r+b") as f:
        f.truncate(size)
    return card


def set_scale(guest, scale):
    guest.ok(f"sed -i 's/^scale = .*/scale = {scale}/' /data/datum/station.toml && sync && systemctl restart --no-block datum")


def first_start(out, name, stick=None, scale="0.25"):
    guest = Guest(out, new_card(out, name), stick)
    guest.power_on()
    guest.shell()
    set_scale(guest, scale)
    guest.ready(1500)
    return guest


def trial_boot(out, _):
    guest = Guest(out, new_card(out, "boot"))
    guest.power_on()
    guest.shell()
    print(f"console after {guest.age():.0f} s")
    print(f"power-on to READY: {guest.ready(1500):.0f} s (first start: identity, data grown, the first model taught)")
    guest.run("systemctl is-system-running --wait", 600)
    failed = guest.ok("systemctl --failed --no-legend --plain")
    must(failed == "", f"failed units: {failed}")
    print("systemctl --failed: empty")
    security = guest.ok("systemd-analyze security --no-pager datum.service | tail -1", 300)
    print(security)
    exposure = float(re.search(r"datum\.service: ([0-9.]+)", security)[1])
    must(exposure <= 2.5, f"exposure {exposure}, allowed: up to 2.5")
    for what, command in [("memory", "grep -E 'VmRSS|VmHWM' /proc/$(systemctl show -p MainPID --value datum)/status | tr '\\n' ' '"),
                          ("data", "df -h /data | tail -1"), ("slot", "cat /proc/cmdline"), ("hostname", "cat /proc/sys/kernel/hostname"),
                          ("watchdog", "systemctl show -p RuntimeWatchdogUSec -p WatchdogDevice | tr '\\n' ' '"),
                          ("journal", "journalctl --disk-usage"), ("listens", "ss -Hltn | tr '\\n' ' '")]:
        print(f"{what}: {guest.ok(command)}")
    identity = guest.ok("cat /data/machine-id /etc/machine-id /data/datum/identity/hostname; sed -n 's/^serial = //p' /data/datum/station.toml")
    must(guest.run("touch /usr/x")[1] != 0, "the root can be written to")
    listening = set(re.findall(r"[^\s:]:(\d+)\s", guest.ok("ss -Hltn")))
    must(listening == {"502"}, f"listens on {listening}, allowed: 502 alone")
    guest.power_off()
    guest.power_on()
    guest.shell()
    print(f"second start, power-on to READY: {guest.ready(1500):.0f} s")
    again = guest.ok("cat /data/machine-id /etc/machine-id /data/datum/identity/hostname; sed -n 's/^serial = //p' /data/datum/station.toml")
    must(identity == again, f"another identity: {identity} became {again}")
    guest.ok("cd /data/datum && datum backup /data/b.datum")
    must("Nothing to do" in guest.ok("cd /data/datum && datum restore --dry-run /data/b.datum"), "a backup is not what is there")
    print("identity as before; a backup is what is there")
    guest.power_off()


def wait_good(guest, seconds=900):
    said = ""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        state = guest.ok("systemctl show -p ActiveState --value datum-good")
        said = guest.ok("journalctl -b -u datum-good --no-pager -o cat | tail -12")
        must(state != "failed", f"datum-good failed: {said}")
        if state == "active":
            return said
        time.sleep(5)
    raise Failed(f"not marked good within {seconds} s: {said}")


def keep_some(guest):
    """Reference captures: every good vehicle's images are kept until there are some."""
    guest.ok("systemctl stop datum && printf '[records]\\nkeep_every = 1\\n' >>/data/datum/station.toml && systemctl start datum", 900)
    for _ in range(120):
        said = guest.ok("ls /data/datum/records/captures 2>/dev/null | wc -l")
        if int(said) >= 4:
            return
        time.sleep(5)
    raise Failed(f"{said} kept captures")


def stick(out, name, *bundles):
    """A USB stick with bundles, as it comes from a shop: one partition, FAT."""
    image = f"{out}/{name}.stick"
    size = sum(os.path.getsize(f"{out}/{bundle}") for bundle in bundles) + (64 << 20)
    start = 2048  # of the partition, in sectors of 512 bytes
    with open(image, "wb") as f:
        f.truncate(size)
    subprocess.run(["sfdisk", "-q", image], input=f"{start},,c\n", text=True, check=True)
    subprocess.run(["mkfs.vfat", "-F", "32", "--offset", str(start), image, str((size >> 10) - start // 2)],
                   check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["mcopy", "-i", f"{image}@@{start * 512}", *[f"{out}/{bundle}" for bundle in bundles], "::"], check=True)
    return image


def mount_stick(guest):
    """As board/README.md says it, once the kernel has found the stick."""
    guest.ok("for n in $(seq 120); do [ ! -b /dev/sda1 ] || break; sleep 1; done; mountpoint -q /mnt || mount -o ro /dev/sda1 /mnt", 600)


def install(guest, bundle):
    begun = time.monotonic()
    said, status = guest.run(f"rauc install /mnt/{bundle} 2>&1 | grep -v '%'; test ${{PIPESTATUS[0]}} = 0", 1800)
    return status, said, time.monotonic() - begun


def reboot(guest):
    guest.console.sendall(b"sync; systemctl reboot\n")
    guest.begun = time.monotonic()
    guest.shell(900)


def trial_memory(out, n):
    """Memory of datum at the camera's full resolution: VmHWM, the most it ever had resident, until READY and over N vehicles."""
    guest = Guest(out, new_card(out, "memory"))
    guest.power_on()
    guest.shell()
    set_scale(guest, "1")
    print(f"READY {guest.ready(3000):.0f} s after power-on, at full resolution")
    status = "/proc/$(systemctl show -p MainPID --value datum)"
    peak = lambda: int(guest.ok(f"sed -n 's/^VmHWM: *//p' {status}/status").split()[0]) / 1024
    until_ready = peak()
    print(f"until READY, with the models taught: VmHWM {until_ready:.0f} MiB", flush=True)
    guest.ok(f"echo 5 >{status}/clear_refs")
    for k in range(n or 3):
        measures(guest, 3000)
        print(f"vehicle {k + 1}: VmHWM since READY {peak():.0f} MiB; {guest.ok('systemctl show -p MemoryCurrent -p MemoryPeak datum | xargs')}", flush=True)
    failed = guest.ok("systemctl --failed --no-legend --plain")
    must(failed == "", f"failed units: {failed}")
    measuring = peak()
    guest.power_off()
    must(max(until_ready, measuring) <= 250, f"datum had {until_ready:.0f} MiB until READY and {measuring:.0f} MiB since, allowed: 250")


def trial_update(out, _):
    guest = first_start(out, "update", stick(out, "update", "next.raucb"))
    must(guest.slot() == "A", "the factory's slot is A")
    wait_good(guest)
    keep_some(guest)
    before = guest.records()[0]
    mount_stick(guest)
    status, said, took = install(guest, "next.raucb")
    must(status == 0, f"rauc install: {said}")
    print(f"bundle installed in {took:.0f} s")
    reboot(guest)
    must(guest.slot() == "B", "after the update the other slot runs")
    print(f"in slot B, READY {guest.ready(1500):.0f} s after the reboot")
    said = wait_good(guest, 1500)
    print(said)
    must(re.search(r"(\d+) of \1 reproduced", said) and not re.search(r"\b0 of 0 reproduced", said), "no reference captures were reproduced")
    must(guest.ok("fw_printenv -n BOOT_B_LEFT") == "3", "B has its starts back")
    after = guest.records()[0]
    must(after[:len(before)] == before, "records were lost")
    guest.ok("rauc status mark-active other")
    reboot(guest)
    must(guest.slot() == "A", "rolled back by command")
    print(f"rolled back by command: slot A, READY {guest.ready(1500):.0f} s after the reboot")
    guest.power_off()


def measures(guest, seconds=900):
    """The system runs and measures: READY, and a vehicle's record more."""
    guest.ready(1500)
    before = guest.records()[0]
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        now = guest.records()[0]
        must(now[:len(before)] == before, "records were lost")
        if len(now) > len(before):
            return
        time.sleep(3)
    raise Failed("no vehicle is measured")


def trial_bad(out, _):
    guest = first_start(out, "bad", stick(out, "bad", "fails.raucb", "hangs.raucb", "foreign.raucb", "torn.raucb", "next.raucb"))
    wait_good(guest)
    keep_some(guest)
    config = guest.ok("sha256sum /data/datum/station.toml")
    for bundle in ["foreign.raucb", "torn.raucb"]:
        mount_stick(guest)
        status, said, _ = install(guest, bundle)
        must(status != 0, f"{bundle} was installed")
        print(f"{bundle} refused: {[line for line in said.splitlines() if line][-1]}")
        guest.ok("umount /mnt")
        must(guest.slot() == "A", "still in A")
    measures(guest)
    for bundle, why in [("fails.raucb", "does not pass its self-test"), ("hangs.raucb", "hangs at boot"),
                        ("next.raucb", "does not reproduce the reference captures")]:
        if bundle == "next.raucb":  # by a longer baseline their poses are others: they are not reproduced
            kept = "/data/datum/records/captures/*/calibration.toml"
            guest.ok(f"sed -i -E 's/^translation_mm = .([0-9]+)[.]/translation_mm = [\\1.1/' {kept} && grep -q '^translation_mm = .[0-9]*[.]1' {kept} && sync")
        mount_stick(guest)
        status, said, took = install(guest, bundle)
        must(status == 0, f"{bundle}: {said}")
        begun = time.monotonic()
        guest.console.sendall(b"sync; systemctl reboot\n")
        guest.text = ""
        tried = 0
        while True:  # starts of B, until A runs again
            found = guest.until(r"datum: starting slot (\w)", 1800)
            if found[1] == "A":
                break
            tried += 1
            must(tried <= 3, "the bad slot was started more than three times")
        must(tried >= 1, "the new slot was never tried")
        guest.shell(900)
        must(guest.slot() == "A", "the former version runs again")
        measures(guest)
        print(f"{bundle} ({why}): {tried} starts, back in slot A and measuring after {time.monotonic() - begun:.0f} s")
    guest.ok("tail -1 /var/lib/datum/refused | sed 's/.* build \\([^:]*\\): .*/\\1/' >>/var/lib/datum/accepted && rauc status mark-active other")
    reboot(guest)
    must(guest.slot() == "B", "the version that was accepted by hand runs")
    measures(guest)
    must("is good" in wait_good(guest), "the version that was accepted by hand is not marked good")
    print("accepted by hand, the refused version runs in slot B and is marked good")
    must(guest.ok("sha256sum /data/datum/station.toml") == config, "the configuration changed")
    guest.power_off()


def trial_install_cuts(out, n):
    rng = random.Random(10)
    guest = first_start(out, "install-cuts", stick(out, "install-cuts", "next.raucb"))
    wait_good(guest)
    config = guest.ok("sha256sum /data/datum/station.toml")
    mount_stick(guest)
    _, _, took = install(guest, "next.raucb")
    reboot(guest)
    guest.ready(1500)
    wait_good(guest, 1500)
    print(f"an installation takes {took:.0f} s")
    for k in range(n or 10):
        slot = guest.slot()
        before = guest.records()[0]
        mount_stick(guest)
        guest.console.sendall(b"rauc install /mnt/next.raucb\n")
        after_s = rng.uniform(0.05, 1.0) * took
        end = time.monotonic() + after_s
        while time.monotonic() < end:
            guest.read()
        guest.cut()
        guest.power_on()
        guest.shell(900)
        must(guest.slot() == slot or after_s > 0.8 * took, f"cut after {after_s:.0f} s: slot {guest.slot()}, it was {slot}")
        measures(guest)
        now = guest.records()[0]
        must(now[:len(before)] == before, "records were lost")
        must(guest.ok("sha256sum /data/datum/station.toml") == config, "the configuration changed")
        print(f"cut {k + 1} after {after_s:.1f} of {took:.0f} s: slot {guest.slot()} runs and measures")
    guest.power_off()


def trial_measure_cuts(out, n):
    rng = random.Random(20)
    guest = first_start(out, "measure-cuts")
    config = guest.ok("sha256sum /data/datum/station.toml")
    seen = 0
    for k in range(n or 20):
        end = time.monotonic() + rng.uniform(2, 40)
        while time.monotonic() < end:
            seen = max(seen, last_record(guest))
            time.sleep(0.2)
        guest.cut()
        guest.power_on()
        guest.shell(900)
        ready = guest.ready(1500)
        ids, said = guest.records()
        must(seen in ids or seen == 0, f"record {seen} was acknowledged and is lost: {ids[-5:]}")
        must(ids == list(range(ids[0], ids[-1] + 1)), f"a gap in the records: {ids}")
        must(guest.ok("sha256sum /data/datum/station.toml") == config, "the configuration changed")
        must(guest.ok("systemctl --failed --no-legend --plain") == "", "a unit failed")
        print(f"cut {k + 1}: READY after {ready:.0f} s, {len(ids)} records, the last acknowledged {seen}; {said or 'no damage'}")
    guest.power_off()


def last_record(guest):
    """The key of the last result's record, as the PLC reads it; 0: none yet."""
    words = guest.registers(99, 4)  # RECORD_ID, high word first; all ones: no result yet
    value = 0 if words is None else sum(word << 48 - 16 * k for k, word in enumerate(words))
    return 0 if value == (1 << 64) - 1 else value


if __name__ == "__main__":
    out, trial = os.path.abspath(sys.argv[1]), sys.argv[2]
    n = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    trials = {name[6:].replace("_", "-"): f for name, f in list(globals().items()) if name.startswith("trial_")}
    if trial not in trials:
        sys.exit(f"trial {trial!r}, allowed: {', '.join(trials)}")
    begun = time.monotonic()
    try:
        trials[trial](out, n)
    except Failed as e:
        sys.exit(f"image {trial} FAILED after {time.monotonic() - begun:.0f} s: {e}")
    print(f"image {trial}: holds, {time.monotonic() - begun:.0f} s")
