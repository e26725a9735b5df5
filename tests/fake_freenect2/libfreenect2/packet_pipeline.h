// What the shim uses of libfreenect2's header of this name; its classes here only tell which one they are.
#pragma once

namespace libfreenect2 {

class DataCallback {};
struct RgbPacketProcessor {
  bool native;
};
struct ConfigPacketProcessor {
  bool cpu;
};
#define DepthPacketProcessor ConfigPacketProcessor

class PacketPipeline {
 public:
  typedef DataCallback PacketParser;
  virtual ~PacketPipeline() {}
  virtual PacketParser *getRgbPacketParser() const { return nullptr; }
  virtual PacketParser *getIrPacketParser() const { return nullptr; }
  virtual RgbPacketProcessor *getRgbPacketProcessor() const { return nullptr; }
  virtual DepthPacketProcessor *getDepthPacketProcessor() const { return nullptr; }
};

template <bool Native, bool Cpu>
class FakePipeline : public PacketPipeline {
 public:
  PacketParser *getRgbPacketParser() const override { return &color_parser_; }
  PacketParser *getIrPacketParser() const override { return &depth_parser_; }
  RgbPacketProcessor *getRgbPacketProcessor() const override { return &color_; }
  DepthPacketProcessor *getDepthPacketProcessor() const override { return &depth_; }

 private:
  mutable DataCallback color_parser_, depth_parser_;
  mutable RgbPacketProcessor color_{Native};
  mutable DepthPacketProcessor depth_{Cpu};
};

typedef FakePipeline<false, true> CpuPacketPipeline;
typedef FakePipeline<true, false> DumpPacketPipeline;

}  // namespace libfreenect2
