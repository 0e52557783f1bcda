/* SPDX-License-Identifier: MIT */
/* The host's files for a program that was written for semihosting. */

#include "semihosting.h"

#include <stdio.h>

static FILE *file[8];

int32_t semihosting_open(const char *name, enum semihosting_mode mode)
{
    for (int32_t k = 0; k < 8; k++) {
        if (file[k] == NULL) {
            file[k] = fopen(name, (mode == SEMIHOSTING_READ) ? "rb" : "wb");
            return (file[k] == NULL) ? -1 : k;
        }
    }
    return -1;
}

int32_t semihosting_close(int32_t handle)
{
    return (fclose(file[handle]) == 0) ? 0 : -1;
}

uint32_t semihosting_read(int32_t handle, void *out, uint32_t size)
{
    return (uint32_t)fread(out, 1, size, file[handle]);
}

uint32_t semihosting_write(int32_t handle, const void *from, uint32_t size)
{
    return (uint32_t)fwrite(from, 1, size, file[handle]);
}

void semihosting_print(const char *text)
{
    fputs(text, stderr);
}
