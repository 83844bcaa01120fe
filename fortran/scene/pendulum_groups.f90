!> The &pendulum group of a scene.
module viscovib_pendulum_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: equations_names, new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: read_pendulum

contains

  subroutine read_pendulum(reader, pendulum)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters) :: p
    type(status_type) :: built
    character(len=:), allocatable :: word

    p%e = reader%read_real('e')
    p%w2 = reader%read_real('w2')
    p%w3 = reader%read_real('w3')
    p%alpha = reader%read_real('alpha', 0.0_wp)
    p%damping(1) = reader%read_real('c1', 0.0_wp)
    p%damping(2) = reader%read_real('c2', 0.0_wp)
    p%damping(3) = reader%read_real('c3', 0.0_wp)
    p%load(1) = reader%read_real('f0', 0.0_wp)
    p%load(2) = reader%read_real('m01', 0.0_wp)
    p%load(3) = reader%read_real('m02', 0.0_wp)
    p%frequency(1) = reader%read_real('p1', 0.0_wp)
    p%frequency(2) = reader%read_real('p2', 0.0_wp)
    p%frequency(3) = reader%read_real('p3', 0.0_wp)
    word = reader%read_text('equations', 'exact', equations_names, p%equations)
    if (reader%status%failed()) return
    call new_pendulum(pendulum, p, built)
    call reader%place(built)
  end subroutine read_pendulum

end module viscovib_pendulum_groups
