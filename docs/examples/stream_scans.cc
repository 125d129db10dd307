// Streams scans to Revisit and prints the loops that it finds. Poses: metres, quaternion x, y, z, w; z points up.
#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <numeric>
#include <string>
#include <vector>

#include "revisit/v1/ingest.grpc.pb.h"
#include "revisit/v1/map.grpc.pb.h"
#include "revisit/v1/session.grpc.pb.h"

namespace rv = revisit::v1;

struct Scan {
  int64_t stamp_ns;
  double position[3], quaternion_xyzw[4];
  std::vector<float> xyz;  // x0, y0, z0, x1, ...
};

bool next_scan(Scan* scan);  // yours: the next sweep of the LiDAR with the pose of your odometry

// Counts the way over all scans, and says of which descriptions are made: see ScanMarks in ingest.proto.
struct Choice {
  double travelled_m = 0, before[3], chosen_m = -1;
  bool begun = false;
  std::vector<std::array<double, 4>> orientations;  // of the scans that were chosen since the last mark

  void go_on(double way_m, const double* position) {
    travelled_m = chosen_m = way_m;
    std::copy(position, position + 3, before);
    begun = true;
  }

  bool takes(const Scan& scan, const rv::ScanMarks& marks) {
    double step = 0;
    for (int i = 0; begun && i < 3; ++i) step += std::pow(scan.position[i] - before[i], 2);
    if (!begun || std::sqrt(step) >= marks.least_step_m()) {  // a robot that stands trembles
      travelled_m += std::sqrt(step);
      std::copy(scan.position, scan.position + 3, before);
    }
    begun = true;
    double per_tau = marks.least_per_tau();
    while (per_tau * (scan.xyz.size() / 3) < marks.enough_returns() && per_tau < 640) per_tau *= 2;
    const double spacing_m = marks.tau_m() / per_tau;
    const auto mark = [&](double way_m) { return std::floor(way_m / spacing_m + 0.5); };
    const std::array<double, 4> q = {scan.quaternion_xyzw[0], scan.quaternion_xyzw[1], scan.quaternion_xyzw[2],
                                     scan.quaternion_xyzw[3]};
    if (chosen_m < 0 || mark(travelled_m) > mark(chosen_m)) {
      chosen_m = travelled_m;
      orientations.clear();
    } else {
      for (const auto& known : orientations) {
        const double cosine = std::abs(std::inner_product(q.begin(), q.end(), known.begin(), 0.0));
        if (cosine > std::cos(marks.turn_rad() / 2)) return false;
      }
    }
    orientations.push_back(q);
    return true;
  }
};

void fill(const Scan& scan, uint64_t seq, double travelled_m, rv::Scan* message) {
  message->set_seq(seq);
  message->set_travelled_m(travelled_m);
  message->set_stamp_ns(scan.stamp_ns);
  auto* translation = message->mutable_t_odom_sensor()->mutable_translation();
  translation->set_x(scan.position[0]);
  translation->set_y(scan.position[1]);
  translation->set_z(scan.position[2]);
  auto* rotation = message->mutable_t_odom_sensor()->mutable_rotation();
  rotation->set_x(scan.quaternion_xyzw[0]);
  rotation->set_y(scan.quaternion_xyzw[1]);
  rotation->set_z(scan.quaternion_xyzw[2]);
  rotation->set_w(scan.quaternion_xyzw[3]);
  auto* packed = message->mutable_cloud()->mutable_packed();
  const char* names[] = {"x", "y", "z"};
  for (uint32_t axis = 0; axis < 3; ++axis) {
    auto* field = packed->add_fields();
    field->set_name(names[axis]);
    field->set_offset(4 * axis);
    field->set_datatype(7);  // FLOAT32
    field->set_count(1);
  }
  packed->set_point_stride(12);
  packed->set_width(scan.xyz.size() / 3);
  packed->set_height(1);
  packed->set_data(scan.xyz.data(), scan.xyz.size() * sizeof(float));
}

int main(int argc, char** argv) {
  const std::string address = argc > 1 ? argv[1] : "127.0.0.1:8090";
  auto channel = grpc::CreateChannel(address, grpc::InsecureChannelCredentials());

  rv::CreateMapRequest new_map;  // creates are idempotent: the same again is no error
  new_map.set_map_id("plant");
  rv::CreateMapResponse map;
  grpc::ClientContext of_map;
  rv::MapService::NewStub(channel)->CreateMap(&of_map, new_map, &map);

  rv::CreateSessionRequest new_session;
  new_session.set_parent("maps/plant");
  new_session.set_session_id("monday");
  rv::CreateSessionResponse session;
  grpc::ClientContext of_session;
  rv::SessionService::NewStub(channel)->CreateSession(&of_session, new_session, &session);

  auto ingest = rv::IngestService::NewStub(channel);
  grpc::ClientContext context;
  auto stream = ingest->StreamScans(&context);
  rv::StreamScansRequest request;
  request.mutable_open()->set_session("maps/plant/sessions/monday");
  request.mutable_open()->set_watch_loop_closures(true);
  stream->Write(request);

  uint64_t seq = 0, credits = 0;
  bool more = true, ended = false;
  rv::ScanMarks marks;
  Choice choice;
  rv::StreamScansResponse answer;
  while (stream->Read(&answer)) {
    if (answer.has_opened()) {
      seq = answer.opened().committed_seq();
      credits = answer.opened().credits();
      marks = answer.opened().marks();
      if (answer.opened().has_t_odom_sensor()) {
        const auto& at = answer.opened().t_odom_sensor().translation();
        const double position[3] = {at.x(), at.y(), at.z()};
        choice.go_on(answer.opened().travelled_m(), position);
      }
    } else if (answer.has_ack()) {
      credits += answer.ack().credits();
    } else if (answer.has_nack()) {
      std::cerr << "scan " << answer.nack().seq() << ": " << answer.nack().reason() << "\n";
      return 1;
    } else if (answer.has_loop_closed()) {
      std::cout << answer.loop_closed().loop_closure().name() << "\n";
    }
    Scan scan;
    while (more && credits > 0 && (more = next_scan(&scan))) {
      if (!choice.takes(scan, marks)) continue;
      request.Clear();
      fill(scan, ++seq, choice.travelled_m, request.mutable_scan());
      stream->Write(request);
      --credits;
    }
    if (!more && !ended) ended = stream->WritesDone();
  }
  const grpc::Status end = stream->Finish();
  std::cout << (end.ok() ? "all scans are stored" : end.error_message()) << "\n";
  return end.ok() ? 0 : 1;
}
