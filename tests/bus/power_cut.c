/* SPDX-License-Identifier: MIT */
/* Loaded before the C library of a node: ends the process at the n-th change of the disk, as a loss of power does. What
   was written and not flushed is lost from the middle on. CUT: n, counted from 1; the changes that there were are
   appended to the file of CUT_LOG as they come. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define PART (5u * 1024u * 1024u)

static int changes;
static int dirty = -1; /* a descriptor that was written and not flushed, */
static int kept = -1;  /* and another of the same file */

static void note(const char *what)
{
    const char *name = getenv("CUT_LOG");
    FILE *log = fopen(name, "a");
    fprintf(log, "%s\n", what);
    fclose(log);
}

static void change(const char *what)
{
    const char *cut = getenv("CUT");
    changes++;
    if (cut && (changes == atoi(cut))) {
        struct stat size;
        if ((kept >= 0) && ((fstat(kept, &size) != 0) || (ftruncate(kept, size.st_size / 2) != 0))) {
            note("not truncated");
        }
        raise(SIGKILL);
    }
    note(what);
}

static int is_state(const char *path)
{
    return strstr(path, "state.zyg") != NULL;
}

int open(const char *path, int flags, ...)
{
    int (*next)(const char *, int, ...) = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
    va_list arguments;
    va_start(arguments, flags);
    const int mode = (flags & O_CREAT) ? va_arg(arguments, int) : 0;
    va_end(arguments);
    const int writes = is_state(path) && (flags & O_WRONLY);
    if (writes) {
        change("open");
    }
    const int fd = next(path, flags, mode);
    if (writes) {
        dirty = fd;
        kept = dup(fd);
    }
    return fd;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
    ssize_t (*next)(int, const void *, size_t) = (ssize_t(*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    if (fd != dirty) {
        return next(fd, bytes, size);
    }
    change("write");
    return next(fd, bytes, (size > PART) ? PART : size); /* in parts, so that it can be cut in between */
}

int fsync(int fd)
{
    int (*next)(int) = (int (*)(int))dlsym(RTLD_NEXT, "fsync");
    change((fd == dirty) ? "fsync" : "fsync of the folder");
    if (fd == dirty) {
        dirty = -1;
        (void)next(kept);
        kept = -1;
    }
    return next(fd);
}

int rename(const char *from, const char *to)
{
    int (*next)(const char *, const char *) = (int (*)(const char *, const char *))dlsym(RTLD_NEXT, "rename");
    change("rename");
    return next(from, to);
}

int unlink(const char *path)
{
    int (*next)(const char *) = (int (*)(const char *))dlsym(RTLD_NEXT, "unlink");
    change("unlink");
    return next(path);
}

int link(const char *from, const char *to)
{
    int (*next)(const char *, const char *) = (int (*)(const char *, const char *))dlsym(RTLD_NEXT, "link");
    change("link");
    if (getenv("NO_LINKS")) { /* as on a FAT */
        errno = EPERM;
        return -1;
    }
    return next(from, to);
}
