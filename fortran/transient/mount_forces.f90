! Optimize: -O2
!> Forces of the mounts of a body along a motion that is known.
module viscovib_mount_forces
  use viscovib_element_forces, only: element_forces_type, spring_force
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_motion_balance, only: recall
  use viscovib_mounted_body, only: place
  use viscovib_rotation, only: new_rotation, rotation_type
  use viscovib_turning_body, only: body_spring, row_of
  implicit none
  private

  public :: find_mount_forces, find_spring_memory, mount_forces_type

  !> Columns are along the local axes of each mount, those of the first mount first. A fluid track
  !! belongs to `elastic`.
  type, extends(element_forces_type) :: mount_forces_type
    !> Moment of its rotational springs, opposite to the rotation, shape (n, 3 n_mounts).
    real(wp), allocatable :: moment(:, :)
    !> In axes of the floor: the point of each force, shape (n, 3, n_mounts), and the force and the
    !! moment about the origin of all mounts on the floor, shape (n, 6).
    real(wp), allocatable :: point(:, :, :), floor(:, :)
  end type mount_forces_type

contains

  !> Forces at states of a motion.
  subroutine find_mount_forces(springs, mount_of, exact, center, u, rate, memory, forces)
    !> The springs at rest (`springs_at_rest`), those of each mount together, of which the first
    !! three are along its axes; the mount of each.
    type(body_spring), intent(in) :: springs(:)
    integer, intent(in) :: mount_of(:)
    !> True for finite rotations.
    logical, intent(in) :: exact
    !> Centre of mass at rest.
    real(wp), intent(in) :: center(3)
    !> Coordinates and rates relative to the base, shape (n, n_dof).
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :)
    !> As of `find_spring_memory`.
    real(wp), intent(in) :: memory(:, :)
    type(mount_forces_type), intent(out) :: forces
    real(wp), dimension(size(u, 1), size(springs)) :: d, speed, elastic
    integer :: a, first, i, j, m

    call find_elastic(springs, exact, u, rate, d, speed, elastic)
    m = maxval(mount_of)
    allocate (forces%deflection(size(u, 1), 3*m), source=0.0_wp)
    allocate (forces%rate, forces%elastic, forces%damping, source=forces%deflection)
    allocate (forces%memory, forces%moment, source=forces%deflection)
    allocate (forces%point(size(u, 1), 3, m), forces%floor(size(u, 1), 6), source=0.0_wp)
    do j = 1, size(springs)
      m = mount_of(j)
      first = findloc(mount_of, m, 1)
      ! The static equilibrium turns the direction of a rotational spring by a small angle.
      a = maxloc([(abs(sum(springs(j)%direction*springs(first + i)%direction)), i=0, 2)], 1)
      a = 3*(m - 1) + a
      if (springs(j)%turning) then
        forces%moment(:, a) = elastic(:, j) + springs(j)%damping*speed(:, j) + memory(:, j)
        cycle
      end if
      forces%elastic(:, a) = forces%elastic(:, a) + elastic(:, j)
      if (springs(j)%track > 0) cycle
      forces%deflection(:, a) = d(:, j)
      forces%rate(:, a) = speed(:, j)
      forces%damping(:, a) = springs(j)%damping*speed(:, j)
      forces%memory(:, a) = memory(:, j)
    end do
    do m = 1, maxval(mount_of)
      first = findloc(mount_of, m, 1)
      call find_points(springs(first), exact, center, u, forces%point(:, :, m))
      call add_to_floor(springs(first:first + 2), m, forces)
    end do
  end subroutine find_mount_forces

  !> -R * (k d + g) of each spring, shape (size(times), n_springs).
  subroutine find_spring_memory(springs, kernels, exact, ends, u, rate, held, times, memory)
    type(body_spring), intent(in) :: springs(:)
    type(kernel_holder), intent(in) :: kernels(:)
    logical, intent(in) :: exact
    !> As of `recalled_along`.
    real(wp), intent(in) :: ends(0:), held(:), times(:)
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :)
    real(wp), intent(out) :: memory(:, :)
    real(wp), allocatable :: d(:, :), speed(:, :), elastic(:, :), first(:, :), moved(:, :)
    integer :: b, j, k, n

    memory = 0.0_wp
    if (.not. any(springs%kernel > 0)) return
    n = size(u, 2)
    if (.not. exact .and. size(kernels)*n < size(springs) .and. all(is_linear(springs))) then
      ! The coordinates are fewer.
      allocate (moved(size(times), n))
      do k = 1, size(kernels)
        if (.not. any(springs%kernel == k)) cycle
        call recall(kernels, [(k, b=1, n)], ends, u, held, times, moved)
        do j = 1, size(springs)
          if (springs(j)%kernel /= k) cycle
          memory(:, j) = -springs(j)%stiffness*matmul(moved, row_of(springs(j), n))
        end do
      end do
      return
    end if
    allocate (d(size(u, 1), size(springs)), first(1, size(springs)))
    allocate (speed, elastic, mold=d)
    call find_elastic(springs, exact, spread(held, 1, 1), 0.0_wp*spread(held, 1, 1), d(:1, :), &
                      speed(:1, :), first)
    call find_elastic(springs, exact, u, rate, d, speed, elastic)
    call recall(kernels, springs%kernel, ends, elastic, first(1, :), times, memory)
    memory = -memory
  end subroutine find_spring_memory

  elemental logical function is_linear(spring)
    type(body_spring), intent(in) :: spring
    is_linear = size(spring%laws) == 0 .and. .not. any(abs(spring%coefficient) > 0.0_wp)
  end function is_linear

  !> Deflections of all springs, their rates, and forces k d + g(d, d'), shape (n, n_springs).
  subroutine find_elastic(springs, exact, u, rate, d, speed, elastic)
    type(body_spring), intent(in) :: springs(:)
    logical, intent(in) :: exact
    real(wp), intent(in) :: u(:, :), rate(:, :)
    real(wp), intent(out) :: d(:, :), speed(:, :), elastic(:, :)
    type(rotation_type) :: turn
    real(wp) :: row(size(u, 2)), value(size(u, 1))
    integer :: i, j

    if (exact) then
      do i = 1, size(u, 1)
        turn = new_rotation(cmplx(u(i, 4:6), 0.0_wp, wp))
        do j = 1, size(springs)
          call place(springs(j), u(i, :), d(i, j), row, turn)
          speed(i, j) = sum(row*rate(i, :))
        end do
      end do
    end if
    do j = 1, size(springs)
      associate (spring => springs(j))
        if (.not. exact) then
          row = row_of(spring, size(row))
          d(:, j) = matmul(u, row)
          speed(:, j) = matmul(rate, row)
        end if
        elastic(:, j) = spring_force(spring%stiffness, spring%coefficient, d(:, j))
        do i = 1, size(spring%laws)
          call spring%laws(i)%program%evaluate(reshape([d(:, j), speed(:, j)], [size(u, 1), 2]), &
                                               value)
          elastic(:, j) = elastic(:, j) + value
        end do
      end associate
    end do
  end subroutine find_elastic

  !> The point at which a mount acts on the body.
  subroutine find_points(spring, exact, center, u, point)
    type(body_spring), intent(in) :: spring
    logical, intent(in) :: exact
    real(wp), intent(in) :: center(3), u(:, :)
    real(wp), intent(out) :: point(:, :)
    type(rotation_type) :: turn
    complex(wp) :: arm(3)
    integer :: i

    arm = spring%arm
    do i = 1, size(u, 1)
      point(i, :) = center + spring%arm
      if (.not. exact) cycle
      turn = new_rotation(cmplx(u(i, 4:6), 0.0_wp, wp))
      point(i, :) = center + u(i, :3) + real(turn%turned(arm))
    end do
  end subroutine find_points

  !> Add the force and the moment of a mount on the floor.
  subroutine add_to_floor(springs, m, forces)
    !> Along its axes.
    type(body_spring), intent(in) :: springs(3)
    integer, intent(in) :: m
    type(mount_forces_type), intent(inout) :: forces
    real(wp), dimension(size(forces%floor, 1), 3) :: force, moment
    integer :: a, b, j

    force = 0.0_wp
    moment = 0.0_wp
    do a = 1, 3
      j = 3*(m - 1) + a
      do b = 1, 3
        associate (e => springs(a)%direction(b))
          force(:, b) = force(:, b) + e*(forces%elastic(:, j) + forces%damping(:, j) &
                                         + forces%memory(:, j))
          moment(:, b) = moment(:, b) + e*forces%moment(:, j)
        end associate
      end do
    end do
    associate (p => forces%point(:, :, m))
      moment(:, 1) = moment(:, 1) + p(:, 2)*force(:, 3) - p(:, 3)*force(:, 2)
      moment(:, 2) = moment(:, 2) + p(:, 3)*force(:, 1) - p(:, 1)*force(:, 3)
      moment(:, 3) = moment(:, 3) + p(:, 1)*force(:, 2) - p(:, 2)*force(:, 1)
    end associate
    forces%floor(:, :3) = forces%floor(:, :3) + force
    forces%floor(:, 4:) = forces%floor(:, 4:) + moment
  end subroutine add_to_floor

end module viscovib_mount_forces
