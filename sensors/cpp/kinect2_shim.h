// The C interface through which sensors/drivers/kinect2.py drives libfreenect2 by ctypes.
#pragma once
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct k2_device k2_device;

// Frame types are libfreenect2's: 1 colour (the device's own JPEG bytes), 2 infrared (float 0 .. 65535),
// 4 depth (float millimetres). An infrared frame comes before the depth frame of its number. All images are mirrored
// left to right, as libfreenect2 delivers them (its issue 172); sensors/drivers/kinect2.py mirrors them back.
typedef struct {
  uint32_t type;
  uint32_t timestamp;  // ticks of 0.125 ms, wraps around
  uint32_t sequence;   // running number within its type, wraps around
  uint32_t status;     // 0 = good
  uint32_t width;
  uint32_t height;
  uint32_t bytes;
} k2_frame;

// Number of devices that can be opened.
int k2_count(void);
// Serial number of one of them, ended by 0; 0 on success, -1 for a wrong index or too little room.
int k2_serial(int index, char *serial, int size);
// Open by serial number; NULL where that fails.
k2_device *k2_open(const char *serial);
// fx fy cx cy k1 k2 k3 p1 p2 of the infrared camera; fx fy cx cy shift_d shift_m mx[10] my[10] of the colour
// camera (x3y0 x0y3 x2y1 x1y2 x2y0 x0y2 x1y1 x1y0 x0y1 x0y0). Call after k2_start: the device tells them then.
void k2_params(k2_device *device, float infrared[9], float color[26]);
// 0 on success.
int k2_start(k2_device *device);
// Wait for a frame: 1 = one was copied, 0 = none came in time, -1 = `capacity` bytes do not hold it.
int k2_read(k2_device *device, int timeout_ms, k2_frame *frame, void *data, uint32_t capacity);
// Stop and free. No other call may be under way.
void k2_close(k2_device *device);

#ifdef __cplusplus
}
#endif
