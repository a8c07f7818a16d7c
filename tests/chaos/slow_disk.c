/* A disk that takes its time: loaded before libc (LD_PRELOAD), it delays what writes to files below CHAOS_DISK.
 *
 * Only while the file named by CHAOS_SLOW is there, and by CHAOS_SLOW_MS milliseconds for each call. Stores into a mapped
 * file are not delayed, as those of a real disk are not: they go to the page cache.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static void delay(int fd)
{
    int before = errno;
    const char *disk = getenv("CHAOS_DISK"), *slow = getenv("CHAOS_SLOW"), *ms = getenv("CHAOS_SLOW_MS");
    if (disk && slow && ms && access(slow, F_OK) == 0) {
        char link[64], path[4096];
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        ssize_t length = readlink(link, path, sizeof path - 1);
        if (length > 0 && strncmp(path, disk, strlen(disk)) == 0) {
            long total_ms = atol(ms);
            struct timespec left = {total_ms / 1000, total_ms % 1000 * 1000000};
            while (nanosleep(&left, &left) != 0 && errno == EINTR)
                ;
        }
    }
    errno = before;
}

#define DELAYED(result, name, parameters, arguments)                    \
    result name parameters                                              \
    {                                                                   \
        static result(*next) parameters;                                \
        if (!next)                                                      \
            next = (result(*) parameters)dlsym(RTLD_NEXT, #name);       \
        delay(fd);                                                      \
        return next arguments;                                          \
    }

DELAYED(ssize_t, write, (int fd, const void *data, size_t size), (fd, data, size))
DELAYED(ssize_t, writev, (int fd, const struct iovec *parts, int count), (fd, parts, count))
DELAYED(ssize_t, pwrite64, (int fd, const void *data, size_t size, off64_t at), (fd, data, size, at))
DELAYED(int, fsync, (int fd), (fd))
DELAYED(int, fdatasync, (int fd), (fd))
DELAYED(int, ftruncate64, (int fd, off64_t size), (fd, size))
