/* Lets the n-th operation that writes below a folder fail, in a program and in those that it starts.
 *
 * Built by `faults.py` as a library that is loaded before the others (LD_PRELOAD). The operations are counted in a file
 * that all processes share.
 *   FAULT_FOLDER   the folder
 *   FAULT_COUNTER  a file of eight bytes, the count
 *   FAULT_AT       number of the operation that fails, from 1; 0: none
 *   FAULT_ERRNO    with what
 *   FAULT_LASTS    1: all later ones that need space fail, too, as on a disk that is full
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static _Atomic long *counter;
static const char *folder;
static long failing_at;
static int error_number, lasts;

static void begin(void) {
    static int begun;
    if (begun) return;
    begun = 1;
    folder = getenv("FAULT_FOLDER");
    const char *path = getenv("FAULT_COUNTER");
    if (!folder || !path) return;
    failing_at = atol(getenv("FAULT_AT"));
    error_number = atoi(getenv("FAULT_ERRNO"));
    lasts = atoi(getenv("FAULT_LASTS"));
    int fd = open(path, O_RDWR);
    if (fd < 0) return;
    void *shared = mmap(NULL, sizeof(long), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (shared != MAP_FAILED) counter = shared;
}

static int below(const char *path) {
    return strncmp(path, folder, strlen(folder)) == 0;
}

static int fails(int needs_space) {
    long n = atomic_fetch_add(counter, 1) + 1;
    if (failing_at && (n == failing_at || (lasts && needs_space && n > failing_at))) {
        errno = error_number;
        return 1;
    }
    return 0;
}

static int fd_fails(int fd) {
    char link[64], path[PATH_MAX];
    struct stat status;
    begin();
    if (!counter || fstat(fd, &status) || !(S_ISREG(status.st_mode) || S_ISDIR(status.st_mode))) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path) && fails(1);
}

static int path_fails(const char *path, int needs_space) {
    char whole[PATH_MAX], here[PATH_MAX];
    begin();
    if (!counter) return 0;
    if (path[0] != '/' && getcwd(here, sizeof here)) {
        if (snprintf(whole, sizeof whole, "%s/%s", here, path) >= (int)sizeof whole) return 0;
        path = whole;
    }
    return below(path) && fails(needs_space);
}

#define NEXT(name, type) ((type)dlsym(RTLD_NEXT, name))

ssize_t write(int fd, const void *data, size_t size) {
    return fd_fails(fd) ? -1 : NEXT("write", ssize_t (*)(int, const void *, size_t))(fd, data, size);
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t at) {
    return fd_fails(fd) ? -1 : NEXT("pwrite", ssize_t (*)(int, const void *, size_t, off_t))(fd, data, size, at);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    return fd_fails(fd) ? -1 : NEXT("pwrite64", ssize_t (*)(int, const void *, size_t, off64_t))(fd, data, size, at);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    return fd_fails(fd) ? -1 : NEXT("writev", ssize_t (*)(int, const struct iovec *, int))(fd, parts, count);
}

int fsync(int fd) { return fd_fails(fd) ? -1 : NEXT("fsync", int (*)(int))(fd); }

int fdatasync(int fd) { return fd_fails(fd) ? -1 : NEXT("fdatasync", int (*)(int))(fd); }

int ftruncate(int fd, off_t size) { return fd_fails(fd) ? -1 : NEXT("ftruncate", int (*)(int, off_t))(fd, size); }

int ftruncate64(int fd, off64_t size) {
    return fd_fails(fd) ? -1 : NEXT("ftruncate64", int (*)(int, off64_t))(fd, size);
}

int rename(const char *from, const char *to) {
    return path_fails(to, 0) ? -1 : NEXT("rename", int (*)(const char *, const char *))(from, to);
}

int mkdir(const char *path, mode_t mode) {
    return path_fails(path, 1) ? -1 : NEXT("mkdir", int (*)(const char *, mode_t))(path, mode);
}

int link(const char *from, const char *to) {
    return path_fails(to, 1) ? -1 : NEXT("link", int (*)(const char *, const char *))(from, to);
}

int linkat(int from_folder, const char *from, int to_folder, const char *to, int flags) {
    begin();
    if (counter && fd_fails(to_folder)) return -1;
    return NEXT("linkat", int (*)(int, const char *, int, const char *, int))(from_folder, from, to_folder, to, flags);
}
