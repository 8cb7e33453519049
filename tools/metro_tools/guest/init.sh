# PID 1 of the guest: mounts the host's file system as its own, runs the command, reports its status
# and powers off.
#
# `init` in the run directory starts it and sets: engine, run, modules, toolbox, hostname, streams,
# interfaces. It communicates with the launcher through line 0: it sends "up", receives the names of
# signals for the command, and sends "status N" at the end. Lines 1 and 2 carry the command's standard
# output and standard error.

b=$run/busybox
exec 2>&1 # Both are the console, which the launcher stores for error reports.

fail() {
    echo "vcan-guest: $*"
    $b poweroff -f
}

# A user-mode kernel can mount any directory of the host; to an emulated PC the launcher exports three.
case $engine in
uml)
    line=/dev/ttyS
    mount_toolbox() { $b mount -t hostfs -o "$toolbox" hostfs toolbox; }
    prepare_to_let_through() { :; }
    mount_through() { $b mount -t hostfs -o "$1" hostfs "$1"; }
    ;;
qemu)
    line=/dev/hvc
    exported=trans=virtio,version=9p2000.L,msize=512000
    mount_toolbox() { $b mount -t 9p -o "ro,$exported,cache=loose" toolbox toolbox; }
    prepare_to_let_through() {
        $b mkdir /run/vcan-guest/writable
        $b mount -t 9p -o "rw,$exported,cache=mmap" writable /run/vcan-guest/writable
    }
    mount_through() { $b mount -o bind "/run/vcan-guest/writable$1" "$1"; }
    ;;
esac

load_modules() {
    for module in "$modules"/*; do
        $b insmod "$module" || fail "cannot load $module"
    done
}

# The root is an overlay of three file systems: memory on top, then the host's root, read-only, then the
# toolbox, so that the host's own programs have priority. The toolbox is mounted separately because
# a file system must not overlap itself in an overlay.
stack_root() {
    $b mount -t tmpfs -o size=90% tmpfs "$run/mnt" || fail "no tmpfs"
    cd "$run/mnt" || fail "no $run/mnt"
    $b mkdir upper work root toolbox
    mount_toolbox || fail "no toolbox"
    $b mount -t overlay -o "lowerdir=/:toolbox,upperdir=upper,workdir=work" overlay root ||
        fail "no overlay"
}

mount_devices() {
    cd root || fail "no root"
    $b mount -t proc proc proc
    $b mount -t sysfs sysfs sys
    $b mount -t devtmpfs devtmpfs dev
    $b mkdir -p dev/pts dev/shm
    $b mount -t devpts -o mode=620,ptmxmode=666 devpts dev/pts
    $b mount -t tmpfs tmpfs dev/shm
    $b mount -t tmpfs -o mode=755 tmpfs run
    for link in fd:fd stdin:fd/0 stdout:fd/1 stderr:fd/2; do
        $b ln -s "/proc/self/${link#*:}" "dev/${link%%:*}"
    done
}

enter_root() {
    $b mkdir -p run/vcan-guest/host
    $b pivot_root . run/vcan-guest/host || fail "cannot change the root"
    cd / || fail "no root"
    $b umount -l /run/vcan-guest/host
}

let_through() {
    prepare_to_let_through || fail "cannot write to the host"
    mount_through "$run" || fail "cannot mount $run"
    while read -r directory; do
        mount_through "$directory" || fail "cannot mount $directory"
    done <"$run/writable"
}

raise_network() {
    $b hostname "$hostname"
    $b ip link set lo up multicast on
    $b ip route add 224.0.0.0/4 dev lo
    [ -d /proc/net/can ] || fail "this kernel has no CAN"
    for name in $interfaces; do
        $b ip link add name "$name" type vcan && $b ip link set "$name" up || fail "cannot make $name"
    done
}

open_lines() {
    cd /run/vcan-guest || fail "no /run/vcan-guest"
    $b stty -F "${line}0" raw -echo
    for stream in $streams; do
        $b mkfifo "$stream"
        $b stty -F "$line$stream" raw -echo
        $b cat <"$stream" >"$line$stream" &
        relays="$relays $!"
    done
}

# Sends a signal once to each process of the command's group, as a terminal would. The leader of the
# group, `timeout`, is left out, because it would send the signal to all of them a second time.
pass_signals() {
    while read -r signal; do
        [ -s command.pid ] || continue
        leader=$($b cat command.pid)
        members=$($b ps -o pid,pgid | while read -r process group; do
            [ "$group" = "$leader" ] && [ "$process" != "$leader" ] && echo "$process"
        done)
        # shellcheck disable=SC2086 # a list of process numbers
        kill -s "$signal" ${members:-$leader}
    done <"${line}0"
}

# Remaining processes would keep the output open.
end_the_rest() {
    for process in /proc/[0-9]*; do
        process=${process#/proc/}
        case " 1 $relays " in
        *" $process "*) ;;
        *) kill -9 "$process" ;;
        esac
    done 2>/dev/null
    # shellcheck disable=SC2086 # a list of process numbers
    wait $relays
}

relays=
$b mount -t proc proc /proc
load_modules
stack_root
mount_devices
enter_root
let_through
raise_network
open_lines
pass_signals &
echo up >"${line}0"
case $streams in
1) $b sh "$run/command" </dev/null >1 2>&1 ;;
*) $b sh "$run/command" </dev/null >1 2>2 ;;
esac
status=$?
end_the_rest
echo "status $status" >"${line}0"
$b sync
$b poweroff -f
