/* SPDX-License-Identifier: MIT */
#include "store.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include "lock.h"
#include "log.h"

#define AS_PREVIOUS ".previous"
#define AS_PARTIAL ".partial"
#define AS_UNUSABLE ".unusable"
#define LONGEST_SUFFIX (sizeof AS_PREVIOUS)

/* Below it, codes hold the errno of a file that could not be read. */
#define NOT_READ (-1000)

/* What to do about a file that is not used. config: about a configuration; state: about a state, before the file's
   name. */
typedef struct {
    int code;
    const char *config;
    const char *state;
} remedy_t;

static const remedy_t remedies[] = {
    { ZYGOS_E_SNAPSHOT, "check the path", "see what wrote" },
    { ZYGOS_E_FORMAT, "use the version that wrote it", "use the version that wrote" },
    { ZYGOS_E_KIND, "--config is what `zygos compile-model` wrote, --state is not",
      "give --state a file of its own, and rename" },
    { ZYGOS_E_BYTE_ORDER, "write it for this one", "delete" },
    { ZYGOS_E_LAYOUT, "compile the model again with the same version", "use the build that wrote it, or delete" },
    { ZYGOS_E_LENGTH, "copy it again", "restore it from a copy, or delete" },
    { ZYGOS_E_CRC, "copy it again", "restore it from a copy, or delete" },
    { ZYGOS_E_CONFIG, "", "give --config the arm that it is of, or delete" },
    { ZYGOS_E_STATE, "", "delete" },
    { ZYGOS_E_SUMS, "", "delete" },
};

/* What is wrong with a file, behind its name. */
static const char *reason_of(int code)
{
    return (code == ZYGOS_E_FORMAT)    ? "is a snapshot of a format that this node does not read"
           : (code > ZYGOS_E_SNAPSHOT) ? "is refused by the library"
                                       : zygos_text(code);
}

static const remedy_t *remedy_of(int code)
{
    static const remedy_t other = { 0, "compile the model again", "delete" };
    for (uint32_t i = 0; i < sizeof remedies / sizeof remedies[0]; i++) {
        if (remedies[i].code == code) {
            return &remedies[i];
        }
    }
    return &other;
}

/* Reads head and image. Returns the number of bytes, one more than these when there are more, or -1. */
static ssize_t read_all(int fd, uint8_t *head, void *image, size_t size)
{
    uint8_t more;
    struct iovec part[3] = { { head, ZYGOS_SNAPSHOT_HEAD }, { image, size }, { &more, 1 } };
    ssize_t total = 0;
    for (uint32_t k = 0; k < 3u;) {
        const ssize_t got = readv(fd, &part[k], 3 - (int)k);
        if ((got < 0) && (errno == EINTR)) {
            continue;
        }
        if (got <= 0) {
            return (got < 0) ? -1 : total;
        }
        total += got;
        size_t left = (size_t)got;
        while ((k < 3u) && (left >= part[k].iov_len)) {
            left -= part[k++].iov_len;
        }
        if (k < 3u) {
            part[k].iov_base = (char *)part[k].iov_base + left;
            part[k].iov_len -= left;
        }
    }
    return total;
}

/* Returns 1, 0 where there is no such file, or NOT_READ - errno. *length: bytes of head and image that it has. */
static int read_file(const char *path, uint8_t *head, void *image, size_t size, uint32_t *length)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* a pipe without a writer is not waited for */
    if ((fd < 0) && (errno == ENOENT)) {
        return 0;
    }
    const ssize_t got = (fd < 0) ? -1 : read_all(fd, head, image, size);
    const int why = errno;
    if (fd >= 0) {
        (void)close(fd);
    }
    *length = (got < 0) ? 0u : (uint32_t)got;
    return (got < 0) ? NOT_READ - why : 1;
}

int node_store_config(const char *path, zygos_config_t *config)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    uint32_t length;
    const int there = read_file(path, head, config, sizeof *config, &length);
    const int verdict = (there == 1) ? zygos_snapshot_check(ZYGOS_SNAPSHOT_CONFIG, head, config, length) : there;
    if (verdict == 1) {
        return 1;
    }
    if (verdict == 0) {
        return node_log("%s: no such file; remedy: write it with `zygos compile-model`", path);
    }
    if (verdict <= NOT_READ) {
        return node_log("%s: cannot be read (%s); remedy: check the path and its permissions", path,
                        strerror(NOT_READ - verdict));
    }
    return node_log("%s: %s; remedy: %s", path, reason_of(verdict), remedy_of(verdict)->config);
}

const char *node_store_folder(const char *path, char *buffer, size_t size)
{
    (void)snprintf(buffer, size, "%s", path);
    return dirname(buffer);
}

int node_store_open(node_store_t *self, const char *path, const char *config)
{
    *self = (node_store_t){ .path = path, .good = true, .lock = -1 };
    if (path == NULL) {
        return 1;
    }
    char buffer[PATH_MAX];
    if (strlen(path) + LONGEST_SUFFIX > PATH_MAX) {
        return node_log("%s: could not be saved (%s); remedy: a shorter name for --state", path,
                        strerror(ENAMETOOLONG));
    }
    struct stat entry;
    const char *folder = node_store_folder(path, buffer, sizeof buffer);
    const bool reached = (stat(folder, &entry) == 0);
    if (!reached || !S_ISDIR(entry.st_mode)) {
        return node_log("%s: could not be saved (%s); remedy: name a file in a folder that is there", path,
                        strerror(reached ? ENOTDIR : errno));
    }
    const bool writable = (access(folder, W_OK | X_OK) == 0);
    if (!writable) {
        node_log("%s: cannot be saved (%s); remedy: open the folder %s to this user; until then states are lost", path,
                 strerror(errno), folder);
    }
    struct stat other;
    const bool there = (stat(path, &entry) == 0);
    if (there && (stat(config, &other) == 0) && (entry.st_dev == other.st_dev) && (entry.st_ino == other.st_ino)) {
        return node_log("%s: %s; remedy: %s", path, reason_of(ZYGOS_E_KIND), remedy_of(ZYGOS_E_KIND)->config);
    }
    if (there && !S_ISREG(entry.st_mode)) {
        return node_log("%s: cannot be read (%s); remedy: name a file with --state", path,
                        S_ISDIR(entry.st_mode) ? strerror(EISDIR) : "Not a regular file");
    }
    self->lock = writable ? node_lock(path) : -1;
    return (writable && (self->lock < 0)) ? -1 : 1;
}

/* A file that belongs to the state, in buffer[PATH_MAX]. */
static const char *name_of(const node_store_t *self, const char *suffix, char *buffer)
{
    (void)snprintf(buffer, PATH_MAX, "%s%s", self->path, suffix);
    return buffer;
}

/* Returns 1, 0 where there is no such file, an enum zygos_error, or NOT_READ - errno. */
static int take_up(const char *path, const zygos_config_t *config, zygos_t *arm, zygos_background_t *memory)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    uint32_t length;
    const int there = read_file(path, head, &arm->state, sizeof arm->state, &length);
    return (there == 1) ? zygos_resume(arm, config, memory, (uint32_t)sizeof *memory, head, length) : there;
}

/* path: the file that is not used. aside: what it is called from here on, or null where it stays. */
static void log_refusal(const char *path, int verdict, const char *aside)
{
    const char *what = (aside != NULL) ? "kept as " : "a later save replaces it";
    const char *where = (aside != NULL) ? aside : "";
    const char *kept = (aside != NULL) ? aside : path;
    if (verdict <= NOT_READ) {
        node_log("%s: cannot be read (%s); %s%s; remedy: check the disk and the permissions of %s", path,
                 strerror(NOT_READ - verdict), what, where, kept);
        return;
    }
    node_log("%s: %s; %s%s; remedy: %s %s", path, reason_of(verdict), what, where, remedy_of(verdict)->state, kept);
}

/* Gives a FILE that cannot be used another name, so that nothing is lost. The first one stays: it may be the long work
   of another arm, and those behind it a consequence. */
static void put_aside(node_store_t *self, int verdict)
{
    char aside[PATH_MAX];
    struct stat entry;
    (void)name_of(self, AS_UNUSABLE, aside);
    const bool vacant = (lstat(aside, &entry) != 0) && (errno == ENOENT);
    self->good = vacant && (rename(self->path, aside) == 0);
    log_refusal(self->path, verdict, self->good ? aside : NULL);
}

int node_store_load(node_store_t *self, const zygos_config_t *config, zygos_t *arm, zygos_background_t *memory)
{
    if (self->path == NULL) {
        return 0;
    }
    const int newest = take_up(self->path, config, arm, memory);
    if (newest == 1) {
        self->good = true;
        return 1;
    }
    if (newest < 0) {
        put_aside(self, newest);
    }
    char previous[PATH_MAX];
    const int older = take_up(name_of(self, AS_PREVIOUS, previous), config, arm, memory);
    if (older == 1) {
        node_log("%s: %s; goes on from %s, the state before it", self->path, (newest < 0) ? "not used" : "is not there",
                 previous);
        return 1;
    }
    if (older < 0) {
        log_refusal(previous, older, NULL);
    }
    if ((newest == 0) && (older == 0)) {
        return 0;
    }
    return node_log(
        "%s: no state can be used, starts from nothing; remedy: to go on from a copy, end this node, put the "
        "copy there, and start again",
        self->path);
}

static bool write_all(int fd, const void *bytes, size_t size)
{
    const char *at = bytes;
    while (size > 0) {
        const ssize_t done = write(fd, at, size);
        if ((done < 0) && (errno != EINTR)) {
            return false;
        }
        const size_t step = (done < 0) ? 0u : (size_t)done;
        at += step;
        size -= step;
    }
    return true;
}

/* A rename is on the disk when its folder is. */
static bool sync_folder(const char *path)
{
    char buffer[PATH_MAX];
    const int fd = open(node_store_folder(path, buffer, sizeof buffer), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    const bool done = (fd >= 0) && (fsync(fd) == 0);
    if (fd >= 0) {
        (void)close(fd);
    }
    return done;
}

static bool write_snapshot(const char *path, const uint8_t *head, const zygos_arm_t *state)
{
    /* A file of its own: what stands there may be a pipe, or another name of a file of others. */
    (void)unlink(path);
    const int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
    if (fd < 0) {
        return false;
    }
    const bool done =
        write_all(fd, head, ZYGOS_SNAPSHOT_HEAD) && write_all(fd, state, sizeof *state) && (fsync(fd) == 0);
    const int why = errno;
    const bool closed = (close(fd) == 0);
    errno = done ? errno : why;
    return done && closed;
}

/* FILE gets a second name, so that it is there all the time; where a file has but one name it is renamed. Without a
   FILE the generation before stays. */
static bool keep(const char *path, const char *previous)
{
    if ((access(path, F_OK) != 0) && (errno == ENOENT)) {
        return true;
    }
    (void)unlink(previous);
    return (link(path, previous) == 0) || (rename(path, previous) == 0);
}

/* Where FILE cannot be kept as the generation before, it is replaced all the same: one good state is more than none. */
static bool replace(node_store_t *self, const char *partial)
{
    char previous[PATH_MAX];
    (void)name_of(self, AS_PREVIOUS, previous);
    const bool kept = !self->good || keep(self->path, previous);
    if (!kept && !self->alone) {
        node_log("%s: cannot be kept as %s (%s); remedy: remove what stands there", self->path, previous,
                 strerror(errno));
    }
    self->alone = !kept;
    if (rename(partial, self->path) != 0) {
        return false;
    }
    self->good = true;
    return sync_folder(self->path);
}

int node_store_save(node_store_t *self, const uint8_t *head, const zygos_arm_t *state)
{
    char partial[PATH_MAX];
    (void)name_of(self, AS_PARTIAL, partial);
    if (!write_snapshot(partial, head, state) || !replace(self, partial)) {
        const int why = errno;
        (void)unlink(partial);
        self->failed++;
        if (self->failure != why) {
            node_log("%s: cannot be saved (%s); remedy: check the folder and its space", self->path, strerror(why));
        }
        self->failure = why;
        return -1;
    }
    if (self->failed > 0u) {
        node_log("%s: saved again, after %u times that it could not be", self->path, self->failed);
    }
    self->failed = 0;
    self->failure = 0;
    return 1;
}
