/* SPDX-License-Identifier: MIT */
/* Lets Debian 12's User-Mode Linux run on processors with AMX. Preloaded into linux.uml by with-vcan.
 *
 * That kernel knows the extended processor state up to AVX-512 and keys, 2696 bytes, and hands as much to
 * PTRACE_SETREGSET. A host kernel takes nothing less than the whole state, which AMX makes 11008 bytes, so no process
 * of the guest could start. Here the part that the guest does not know is taken from the traced process itself. */

#define _GNU_SOURCE
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define NT_X86_XSTATE 0x202L

long ptrace(enum __ptrace_request request, ...)
{
    va_list list;
    va_start(list, request);
    const long pid = va_arg(list, int);
    long address = va_arg(list, long);
    void *data = va_arg(list, void *);
    va_end(list);

    static char state[65536] __attribute__((aligned(64)));
    struct iovec whole = { state, sizeof state };
    const struct iovec *known = data;
    if ((request == PTRACE_SETREGSET) && (address == NT_X86_XSTATE) &&
        (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole) == 0) && (whole.iov_len > known->iov_len)) {
        memcpy(state, known->iov_base, known->iov_len);
        data = &whole;
    }
    long word = 0;
    const int peek = (request == PTRACE_PEEKTEXT) || (request == PTRACE_PEEKDATA) || (request == PTRACE_PEEKUSER);
    const long result = syscall(SYS_ptrace, request, pid, address, peek ? &word : data);
    return (peek && (result == 0)) ? word : result;
}
