/* SPDX-License-Identifier: MIT */
/// Files and the exit status of the host, through a debugger or an emulator (Arm's semihosting). Without one, every
/// call is a fault of the processor.

#ifndef ZYGOS_SEMIHOSTING_H
#define ZYGOS_SEMIHOSTING_H

#include <stdint.h>

enum semihosting_mode { SEMIHOSTING_READ = 1, SEMIHOSTING_WRITE = 5 }; /* "rb" and "wb" */

/// Opens a file of the host's. Returns its handle, or -1.
int32_t semihosting_open(const char *name, enum semihosting_mode mode);

/// Closes it. Returns 0, or -1 when what was written did not reach the file.
int32_t semihosting_close(int32_t handle);

/// Reads at most size bytes. Returns how many were read; fewer at the end of the file.
uint32_t semihosting_read(int32_t handle, void *out, uint32_t size);

/// Writes size bytes. Returns how many were written.
uint32_t semihosting_write(int32_t handle, const void *from, uint32_t size);

/// Prints a text on the host's console.
void semihosting_print(const char *text);

/// Ends the emulation with an exit status.
_Noreturn void semihosting_exit(int status);

#endif
