/* SPDX-License-Identifier: BSD-3-Clause
 *
 * Preloaded into a process, it adds a shift to the realtime clock: the int64 nanoseconds in the file CLOCK_SHIFT_FILE,
 * which may change while the process runs. The monotonic clock is left alone.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static const int64_t second = 1000000000;

static int64_t shift_ns(void) {
    static volatile int64_t *shift;
    if (shift == NULL) {
        const char *path = getenv("CLOCK_SHIFT_FILE");
        int file = path == NULL ? -1 : open(path, O_RDONLY | O_CLOEXEC);
        void *mapped = file < 0 ? MAP_FAILED : mmap(NULL, sizeof(int64_t), PROT_READ, MAP_SHARED, file, 0);
        if (mapped == MAP_FAILED) return 0;
        shift = mapped;
    }
    return *shift;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*true_clock_gettime)(clockid_t, struct timespec *);
    if (true_clock_gettime == NULL) *(void **)&true_clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    int result = true_clock_gettime(clock, now);
    if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        int64_t shifted = now->tv_sec * second + now->tv_nsec + shift_ns();
        now->tv_sec = shifted / second;
        now->tv_nsec = shifted % second;
    }
    return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    (void)zone;
    struct timespec precise;
    int result = clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return result;
}

time_t time(time_t *result) {
    struct timespec precise;
    clock_gettime(CLOCK_REALTIME, &precise);
    if (result != NULL) *result = precise.tv_sec;
    return precise.tv_sec;
}
