/* Stands in for the loader of Vulkan and passes everything on to the real one (REAL_VULKAN), but for one fault: at the nth (FAULT_AT) call of a kind
   (FAULT: wait, submit or allocation) it says that the device is lost or its memory full. */
#include <dlfcn.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { DEVICE_LOST = -4, OUT_OF_DEVICE_MEMORY = -2 };

typedef void (*Function)(void);
typedef Function (*Find)(void *, const char *);
typedef int (*Wait)(void *, void *, uint64_t);
typedef int (*Submit)(void *, uint32_t, void *, uint64_t);
typedef int (*Allocate)(void *, void *, void *, void *);

static Find find_in_instance, find_in_device;
static Wait real_wait;
static Submit real_submit;
static Allocate real_allocate;

static int is_due(const char *kind) {
    static atomic_int calls;
    const char *fault = getenv("FAULT"), *at = getenv("FAULT_AT");
    if (!fault || !at || strcmp(fault, kind)) {
        return 0;
    }
    if (++calls != atoi(at)) {
        return 0;
    }
    fprintf(stderr, "[faulty driver] %s %s fails\n", kind, at);
    return 1;
}

static int wait(void *device, void *what, uint64_t timeout) {
    return is_due("wait") ? DEVICE_LOST : real_wait(device, what, timeout);
}

static int submit(void *queue, uint32_t count, void *submissions, uint64_t fence) {
    return is_due("submit") ? DEVICE_LOST : real_submit(queue, count, submissions, fence);
}

static int allocate(void *device, void *what, void *allocator, void *memory) {
    return is_due("allocation") ? OUT_OF_DEVICE_MEMORY : real_allocate(device, what, allocator, memory);
}

static Function of_device(void *device, const char *name) {
    Function real = find_in_device(device, name);
    if (real && (!strcmp(name, "vkWaitSemaphores") || !strcmp(name, "vkWaitSemaphoresKHR"))) {
        real_wait = (Wait)real;
        return (Function)wait;
    }
    if (real && !strcmp(name, "vkQueueSubmit")) {
        real_submit = (Submit)real;
        return (Function)submit;
    }
    if (real && !strcmp(name, "vkAllocateMemory")) {
        real_allocate = (Allocate)real;
        return (Function)allocate;
    }
    return real;
}

Function vkGetInstanceProcAddr(void *instance, const char *name) {
    if (!find_in_instance) {
        void *library = dlopen(getenv("REAL_VULKAN"), RTLD_NOW | RTLD_LOCAL);
        if (!library) {
            fprintf(stderr, "%s\n", dlerror());
            abort();
        }
        find_in_instance = (Find)dlsym(library, "vkGetInstanceProcAddr");
    }
    Function real = find_in_instance(instance, name);
    if (real && !strcmp(name, "vkGetDeviceProcAddr")) {
        find_in_device = (Find)real;
        return (Function)of_device;
    }
    return real;
}
