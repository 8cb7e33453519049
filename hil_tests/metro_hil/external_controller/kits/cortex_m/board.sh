#!/bin/sh
# Runs the firmware on the emulated board. Its serial line is standard input and output.
exec qemu-system-arm -machine mps2-an385 -display none -monitor none -serial stdio -semihosting \
    -kernel "$(dirname "$0")/build/@name@.elf"
