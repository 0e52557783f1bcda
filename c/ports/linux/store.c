#include "store.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

#include "say.h"
#include "zygos/snapshot.h"

static int refuse(const char *path, int code)
{
    static const struct {
        int code;
        const char *reason;
        const char *remedy;
    } known[] = {
        { ZYGOS_E_SNAPSHOT, "is no snapshot of zygos", "check the path" },
        { ZYGOS_E_FORMAT, "is a snapshot of a format that this node does not read", "use the version that wrote it" },
        { ZYGOS_E_KIND, "is a snapshot of the other kind",
          "--config is what `zygos compile-model` wrote, --state is not" },
        { ZYGOS_E_BYTE_ORDER, "was written by a machine of the other byte order", "write it for this one" },
        { ZYGOS_E_LAYOUT, "was written by a build with other capacities, structs or version",
          "compile the model again with the same version; a state cannot be carried over: remove it" },
        { ZYGOS_E_LENGTH, "is cut off, or has more bytes than its head says", "copy it again, or remove it" },
        { ZYGOS_E_CRC, "is damaged: its CRC does not fit its bytes", "copy it again, or remove it" },
        { ZYGOS_E_CONFIG, "is the state of another configuration", "give that configuration, or remove the state" },
        { ZYGOS_E_STATE, "was damaged before it was sealed: it holds a count that cannot be", "remove it" },
    };
    for (uint32_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        if (known[i].code == code) {
            return node_say("%s: %s; remedy: %s", path, known[i].reason, known[i].remedy);
        }
    }
    return node_say("%s: the library refuses it with code %d; remedy: compile the model again", path, code);
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

/* Returns 1; 0 where there is no such file; -1 after saying why not. */
static int load(const char *path, uint32_t kind, void *image, size_t size)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if ((fd < 0) && (errno == ENOENT)) {
        return 0;
    }
    const ssize_t length = (fd < 0) ? -1 : read_all(fd, head, image, size);
    if (length < 0) {
        node_say("%s: cannot be read (%s); remedy: check the path and its permissions", path, strerror(errno));
    }
    if (fd >= 0) {
        (void)close(fd);
    }
    if (length < 0) {
        return -1;
    }
    const int verdict = zygos_snapshot_check(kind, head, image, (uint32_t)length);
    return (verdict == 1) ? 1 : refuse(path, verdict);
}

int node_store_config(const char *path, zygos_config_t *config)
{
    const int loaded = load(path, ZYGOS_SNAPSHOT_CONFIG, config, sizeof *config);
    return (loaded == 0) ? node_say("%s: no such file; remedy: write it with `zygos compile-model`", path) : loaded;
}

/* The folder of a path, in a buffer of the caller's. */
static const char *folder_of(const char *path, char *buffer, size_t size)
{
    (void)snprintf(buffer, size, "%s", path);
    return dirname(buffer);
}

int node_store_begin(const char *path, const zygos_config_t *config, zygos_t *arm)
{
    int found = 0;
    if (path != NULL) {
        char buffer[PATH_MAX];
        const bool fits = (strlen(path) + sizeof ".partial" <= PATH_MAX);
        if (!fits || (access(folder_of(path, buffer, sizeof buffer), W_OK | X_OK) != 0)) {
            return node_say(
                "%s: could not be saved (%s); remedy: name a file in a folder that is there, and open to you", path,
                strerror(fits ? errno : ENAMETOOLONG));
        }
        found = load(path, ZYGOS_SNAPSHOT_STATE, arm, sizeof *arm);
        if (found < 0) {
            return -1;
        }
    }
    if (found == 1) {
        const int verdict = zygos_resume(arm, config);
        return (verdict == 1) ? 1 : refuse(path, verdict);
    }
    const int verdict = zygos_init(arm, config);
    return (verdict == 1)
               ? 1
               : node_say("the library refuses the configuration with code %d; remedy: compile it again", verdict);
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
    const int fd = open(folder_of(path, buffer, sizeof buffer), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    const bool done = (fd >= 0) && (fsync(fd) == 0);
    if (fd >= 0) {
        (void)close(fd);
    }
    return done;
}

int node_store_save(const char *path, const zygos_t *arm)
{
    if (path == NULL) {
        return 1;
    }
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    char partial[PATH_MAX];
    (void)snprintf(partial, sizeof partial, "%s.partial", path);
    (void)zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, arm, head);
    const int fd = open(partial, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    bool done = (fd >= 0) && write_all(fd, head, sizeof head) && write_all(fd, arm, sizeof *arm) && (fsync(fd) == 0);
    done = (fd >= 0) && (close(fd) == 0) && done;
    done = done && (rename(partial, path) == 0) && sync_folder(path);
    if (!done) {
        const int why = errno;
        (void)unlink(partial);
        return node_say("%s: cannot be saved (%s); remedy: check the folder and its space", path, strerror(why));
    }
    return 1;
}
