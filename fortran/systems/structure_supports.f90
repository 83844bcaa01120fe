!> Supports of a structure: coordinates that are fixed, move with the base, or move each alone.
!!
!! A motion y of the base moves the supports by u_s = d y. The other coordinates are
!! u_f = r y + w. Then
!!
!!   M_ff w'' + C_ff w' + K_ff w + elements(w) = p - m y'' - c y' - k y,
!!   (m, c, k) = (M_ff r + M_fs d, C_ff r + C_fs d, K_ff r + K_fs d).
!!
!! r is any vector for which no element is stretched, e_f . r + e_s . d = 0: the static deflection
!! of the structure, corrected at the elements. If a support moves alone, the coordinates are
!! absolute, r = 0. Only linear springs and dampers may then act on it.
module viscovib_structure_supports
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_structure_elements, only: element_type
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: structure_supports, new_supports, support_rows

  !> Relative stretch of an element, and relative forces, that are rounding errors.
  real(wp), parameter :: unstretched = 1.0e-12_wp, rounding = 1.0e-13_wp
  !> Largest static deflection relative to the motion of the supports; a larger one is that of a
  !! structure that is not held.
  real(wp), parameter :: largest = 1.0e6_wp
  !> Eigenvalues below this part of the largest are 0.
  real(wp), parameter :: no_part = 1.0e-13_wp

  !> Rows of M, C and K of the supports, without elements.
  type :: support_rows
    !> Columns of the free coordinates, shape (n_held, n_free, 3), and of the supports,
    !! (n_held, n_held, 3).
    real(wp), allocatable :: free(:, :, :), held(:, :, :)
    !> Products with the motion (r, d) of all coordinates with the base, shape (n_held, 3).
    real(wp), allocatable :: based(:, :)
  contains
    procedure :: reactions
  end type support_rows

  type :: structure_supports
    !> Names of the supports.
    character(len=16), allocatable :: names(:)
    !> M_fs d, c and k of a motion of the base, shape (n_free).
    real(wp), allocatable :: mass(:), rate(:), place(:)
    !> M_fs, C_fs and K_fs, with linear elements, shape (n_free, n_held).
    real(wp), allocatable :: masses(:, :), rates(:, :), places(:, :)
    !> The first element on each support that is no linear spring or damper; 0: none.
    integer, allocatable :: bent_by(:)
    !> Rows of the supports, and of gyroscopic, circulatory and centrifugal matrices that are not
    !! contained in them, shape (n_held, n_free, 3); not allocated: none.
    type(support_rows) :: rows
    real(wp), allocatable :: turning(:, :, :)
    !> Motions of supports that move each on its own, Im a exp(i k nu t): orders k, and a, shape
    !! (n_held, size(orders)).
    integer, allocatable :: orders(:)
    complex(wp), allocatable :: waves(:, :)
    !> True if matrices that depend on the speed act on supports.
    logical :: are_turned = .false.
    !> True if a load moves supports that act by springs or dampers.
    logical :: pull = .false.
  contains
    procedure :: are_pulled
    procedure :: move_apart
  end type structure_supports

contains

  !> True if a motion of the base acts by springs or dampers.
  pure logical function are_pulled(self)
    class(structure_supports), intent(in) :: self
    are_pulled = .false.
    if (allocated(self%rate)) are_pulled = any(abs([self%rate, self%place]) > 0.0_wp)
  end function are_pulled

  !> Add the motion Im a exp(i order nu t) of one support.
  pure subroutine move_apart(self, support, order, a)
    class(structure_supports), intent(inout) :: self
    integer, intent(in) :: support, order
    complex(wp), intent(in) :: a
    complex(wp) :: wave(size(self%names))
    wave = (0.0_wp, 0.0_wp)
    wave(support) = a
    self%orders = [self%orders, order]
    self%waves = reshape([self%waves, wave], [size(wave), size(self%orders)])
    self%pull = .true.
  end subroutine move_apart

  !> Find the forces of supports, and the motion (r, d) of all coordinates with the base.
  subroutine new_supports(supports, matrices, elements, free, held, direction, moved, status)
    type(structure_supports), intent(out) :: supports
    !> M, C and K of all coordinates, with the linear parts of elements, shape (n, n, 3).
    real(wp), intent(in) :: matrices(:, :, :)
    !> With directions of all coordinates.
    type(element_type), intent(in) :: elements(:)
    integer, intent(in) :: free(:), held(:)
    !> d, or the motion of all coordinates.
    real(wp), intent(in) :: direction(:)
    real(wp), intent(out) :: moved(:)
    type(status_type), intent(out) :: status
    integer :: i

    call set_ok(status)
    supports%masses = matrices(free, held, 1)
    supports%rates = matrices(free, held, 2)
    supports%places = matrices(free, held, 3)
    supports%bent_by = 0*held
    do i = size(elements), 1, -1
      associate (e => elements(i)%direction)
        if (.not. any(abs(e(free)) > 0.0_wp)) then
          call fail(status, status_input_error, 'supports', 'supports: &element '//show(i) &
                    //': acts on supports only, must act on a free coordinate')
          return
        end if
        if (elements(i)%is_active()) where (abs(e(held)) > 0.0_wp) supports%bent_by = i
      end associate
    end do
    moved = 0.0_wp
    if (size(direction) == size(moved)) then
      moved = direction
    else if (any(abs(direction) > 0.0_wp)) then
      moved(held) = direction
      moved(free) = static_deflection(matrices(free, free, 3), &
                                      -matmul(supports%places, direction), maxval(abs(direction)))
    end if
    call release(elements, free, moved, status)
    supports%mass = matmul(supports%masses, moved(held))
    supports%rate = forces(matrices(free, :, 2), moved)
    supports%place = forces(matrices(free, :, 3), moved)
  end subroutine new_supports

  !> Forces M u'' + C u' + K u on the supports, shape (n, n_held).
  function reactions(self, moved, base, apart) result(force)
    class(support_rows), intent(in) :: self
    !> Displacements, velocities and accelerations: of the free coordinates relative to the base
    !! (n, n_free, 3), of the base (n, 3), and of supports that move each on its own (n, n_held, 3).
    real(wp), intent(in) :: moved(:, :, :), base(:, :), apart(:, :, :)
    real(wp) :: force(size(base, 1), size(self%based, 1))
    integer :: j, p

    force = 0.0_wp
    do p = 1, 3
      ! Matrices are in the order of derivatives from the second on.
      force = force + matmul(moved(:, :, p), transpose(self%free(:, :, 4 - p))) &
              + matmul(apart(:, :, p), transpose(self%held(:, :, 4 - p)))
      do j = 1, size(force, 2)
        force(:, j) = force(:, j) + self%based(j, 4 - p)*base(:, p)
      end do
    end do
  end function reactions

  !> Forces of a motion of all coordinates; rounding errors are 0.
  pure function forces(rows, moved) result(found)
    real(wp), intent(in) :: rows(:, :), moved(:)
    real(wp) :: found(size(rows, 1))
    found = matmul(rows, moved)
    where (abs(found) <= rounding*matmul(abs(rows), abs(moved))) found = 0.0_wp
  end function forces

  !> Static deflection; 0 without supports that hold the structure.
  function static_deflection(stiffness, pull, moved) result(found)
    real(wp), intent(in) :: stiffness(:, :), pull(:)
    !> Largest motion of a support.
    real(wp), intent(in) :: moved
    real(wp) :: found(size(pull)), factors(size(pull), size(pull))
    integer :: pivots(size(pull))
    logical :: singular
    factors = stiffness
    found = pull
    call factorize(size(pull), factors, pivots, singular)
    if (.not. singular) call solve(size(pull), factors, pivots, found)
    if (singular .or. .not. all(abs(found) <= largest*moved)) found = 0.0_wp
  end function static_deflection

  !> Change the motion of the free coordinates as little as possible so that the base stretches no
  !! element.
  subroutine release(elements, free, moved, status)
    type(element_type), intent(in) :: elements(:)
    integer, intent(in) :: free(:)
    real(wp), intent(inout) :: moved(:)
    type(status_type), intent(inout) :: status
    real(wp), dimension(size(elements)) :: stretched, sizes, squares, left
    real(wp), allocatable :: q(:, :), unit(:, :), modes(:, :)
    integer :: i, m, pass

    m = size(elements)
    allocate (q(m, size(moved)))
    do i = 1, m
      q(i, :) = elements(i)%direction
    end do
    stretched = matmul(q, moved)
    sizes = matmul(abs(q), abs(moved))
    if (all(abs(stretched) <= unstretched*sizes)) return
    allocate (unit(m, m), modes(m, m))
    unit = reshape([(merge(1.0_wp, 0.0_wp, mod(i, m + 1) == 0), i=0, m*m - 1)], [m, m])
    call find_symmetric_modes(unit, matmul(q(:, free), transpose(q(:, free))), squares, modes)
    ! The second pass removes rounding errors.
    do pass = 1, 2
      left = matmul(matmul(q, moved), modes)
      where (squares > no_part*maxval(squares))
        left = left/squares
      else where
        left = 0.0_wp
      end where
      moved(free) = moved(free) - matmul(matmul(modes, left), q(:, free))
    end do
    stretched = abs(matmul(q, moved)) - 1.0e3_wp*unstretched*max(sizes, matmul(abs(q), abs(moved)))
    i = maxloc(stretched, 1)
    if (stretched(i) > 0.0_wp) then
      call fail(status, status_input_error, 'base_direction', 'base_direction: stretches spring ' &
                //show(i)//' of elements and layers, whatever the free coordinates do, must ' &
                //'leave one of each free')
    end if
  end subroutine release

end module viscovib_structure_supports
