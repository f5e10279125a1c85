// A counterpart over DDS that is not ours: Fast DDS as Debian has it, with types that fastddsgen made of ros.idl.
//
// peer DOMAIN hear                        prints the first PoseWithCovarianceStamped on rt/localiser/pose
// peer DOMAIN send reliable|best COUNT HZ  sends images and odometry, stamped when they are sent, once a line on stdin
//                                          says that empty ones are heard; leaves when stdin ends

#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <stdexcept>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include "rosPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using Clock = std::chrono::system_clock;
using PoseType = geometry_msgs::msg::dds_::PoseWithCovarianceStamped_PubSubType;
using ImageType = sensor_msgs::msg::dds_::Image_PubSubType;
using OdometryType = nav_msgs::msg::dds_::Odometry_PubSubType;

constexpr int PATIENCE_S = 60;
constexpr int KEPT = 10;
constexpr unsigned WIDTH = 640, HEIGHT = 480;

DomainParticipant* participant_on_loopback(int domain) {
  DomainParticipantQos qos;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList = {"127.0.0.1"};
  udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(udp);
  return DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

template <class Type>
Topic* topic(DomainParticipant* participant, const std::string& name) {
  TypeSupport type(new Type());
  type.register_type(participant);
  return participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
}

template <class Type>
DataWriter* writer(DomainParticipant* participant, const std::string& name, bool reliable) {
  DataWriterQos qos;
  qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
  qos.reliability().max_blocking_time = {PATIENCE_S, 0};
  // Of what is reliable nothing is replaced before it is acknowledged: to write waits for a reader that is busy.
  qos.history().kind = reliable ? KEEP_ALL_HISTORY_QOS : KEEP_LAST_HISTORY_QOS;
  qos.history().depth = KEPT;
  qos.resource_limits().max_instances = 1;
  qos.resource_limits().max_samples = qos.resource_limits().max_samples_per_instance = KEPT;
  qos.resource_limits().allocated_samples = KEPT;
  qos.publish_mode().kind = SYNCHRONOUS_PUBLISH_MODE;
  qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  return participant->create_publisher(PUBLISHER_QOS_DEFAULT)
      ->create_datawriter(topic<Type>(participant, name), qos);
}

template <class Header>
void stamp(Header& header, const char* frame) {
  const auto now = std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch()).count();
  header.stamp().sec(now / 1000000000);
  header.stamp().nanosec(now % 1000000000);
  header.frame_id(frame);
}

int hear(DomainParticipant* participant) {
  DataReaderQos qos;
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)
                     ->create_datareader(topic<PoseType>(participant, "rt/localiser/pose"), qos);
  for (int k = 0; k < PATIENCE_S * 20; ++k) {
    PoseType::type pose;
    SampleInfo info;
    if (reader->wait_for_unread_message({0, 50000000}) &&
        reader->take_next_sample(&pose, &info) == ReturnCode_t::RETCODE_OK && info.valid_data) {
      const auto& at = pose.pose().pose();
      std::printf("%s %d %u %.17g %.17g %.17g %.17g %.17g\n", pose.header().frame_id().c_str(),
                  pose.header().stamp().sec(), pose.header().stamp().nanosec(), at.position().x(), at.position().y(),
                  at.orientation().z(), at.orientation().w(), pose.pose().covariance()[0]);
      return 0;
    }
  }
  return 1;
}

void write(DataWriter* by, void* message) {
  if (!by->write(message)) throw std::runtime_error("a message was not written");
}

void acknowledged(DataWriter* by) {
  if (by->wait_for_acknowledgments({PATIENCE_S, 0}) != ReturnCode_t::RETCODE_OK) {
    throw std::runtime_error("messages were not acknowledged");
  }
}

// That a reader is matched says that it was found, not that it found us. So small messages go out until a line on
// stdin says that they are heard; the last ones are acknowledged where that is asked for.
void until_heard(DataWriter* images, DataWriter* wheels) {
  std::atomic<bool> heard{false};
  std::thread waiting([&heard] {
    std::string line;
    std::getline(std::cin, line);
    heard = true;
  });
  ImageType::type image;
  OdometryType::type odometry;
  while (!heard) {
    write(images, &image);
    write(wheels, &odometry);
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  waiting.join();
  acknowledged(images);
  acknowledged(wheels);
}

int send(DomainParticipant* participant, bool reliable, int count, double hz) {
  auto* images = writer<ImageType>(participant, "rt/camera/image_raw", reliable);
  auto* wheels = writer<OdometryType>(participant, "rt/odom", reliable);
  until_heard(images, wheels);
  ImageType::type image;
  image.height(HEIGHT);
  image.width(WIDTH);
  image.encoding("rgb8");
  image.step(3 * WIDTH);
  image.data().resize(3 * WIDTH * HEIGHT);
  OdometryType::type odometry;
  odometry.child_frame_id("base_link");
  odometry.pose().pose().orientation().w(1.0);
  const auto begin = std::chrono::steady_clock::now();
  for (int k = 0; k < count; ++k) {
    std::this_thread::sleep_until(begin + std::chrono::duration<double>(k / hz));
    std::memset(image.data().data(), k % 256, image.data().size());
    odometry.pose().pose().position().x(0.01 * k);
    stamp(odometry.header(), "odom");
    write(wheels, &odometry);
    stamp(image.header(), "camera_optical_frame");
    write(images, &image);
  }
  acknowledged(images);
  acknowledged(wheels);
  while (std::cin.get() != EOF) {  // that a participant leaves may be heard before what it sent
  }
  return 0;
}

int main(int, char** arguments) {
  auto* participant = participant_on_loopback(std::stoi(arguments[1]));
  if (participant == nullptr) return 2;
  const std::string what = arguments[2];
  return what == "hear"
             ? hear(participant)
             : send(participant, std::string(arguments[3]) == "reliable", std::stoi(arguments[4]), std::stod(arguments[5]));
}
