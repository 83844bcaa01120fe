!> The &layer groups of a scene: stiffness matrices of a structure that relax as a whole.
module viscovib_layer_groups
  use viscovib_coordinate_names, only: read_kernel_place
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: max_coordinates
  use viscovib_status, only: show
  use viscovib_structure_elements, only: element_type
  use viscovib_structure_rest, only: is_symmetric
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: finish_layer

  !> Eigenvalues below this part of the largest are 0.
  real(wp), parameter :: no_part = 1.0e-12_wp

contains

  !> A layer (1 - R*) K u as springs along the eigenvectors of K, which is the same.
  subroutine finish_layer(reader, matrix, is_reduced, n_kernels, springs)
    type(group_reader), intent(inout) :: reader
    !> K, shape (n, n).
    real(wp), intent(in) :: matrix(:, :)
    !> Whether the places with names are not the coordinates.
    logical, intent(in) :: is_reduced
    integer, intent(in) :: n_kernels
    type(element_type), allocatable, intent(out) :: springs(:)
    real(wp), allocatable :: unit(:, :), sizes(:), shapes(:, :)
    integer, allocatable :: touched(:), kept(:)
    integer :: i, kernel, m

    allocate (springs(0))
    kernel = read_kernel_place(reader, n_kernels)
    if (reader%status%failed()) return
    if (is_reduced) then
      call reader%complain('stiffness', '&layer: belongs to a structure in all its coordinates, ' &
                           //'not to one with shapes')
    else if (.not. is_symmetric(matrix)) then
      call reader%complain('stiffness', 'stiffness: must be symmetric, as that of a layer')
    end if
    if (reader%status%failed()) return
    touched = pack([(i, i=1, size(matrix, 1))], any(abs(matrix) > 0.0_wp, 2))
    m = size(touched)
    if (m == 0) return
    allocate (unit(m, m), sizes(m), shapes(m, m))
    unit = 0.0_wp
    do i = 1, m
      unit(i, i) = 1.0_wp
    end do
    call find_symmetric_modes(unit, matrix(touched, touched), sizes, shapes)
    kept = pack([(i, i=1, m)], abs(sizes) > no_part*maxval(abs(sizes)))
    if (kernel > 0 .and. size(kept) > max_coordinates) then
      call reader%complain('stiffness', 'stiffness: its layer acts in '//show(size(kept)) &
                           //' directions, must be at most '//show(max_coordinates)//' here; ' &
                           //'Structure(layers=) of Python takes any number with a kernel that ' &
                           //'is a sum of exponentials')
      return
    end if
    deallocate (springs)
    allocate (springs(size(kept)))
    do i = 1, size(kept)
      allocate (springs(i)%direction(size(matrix, 1)), source=0.0_wp)
      allocate (springs(i)%laws(0))
      springs(i)%direction(touched) = shapes(:, kept(i))
      springs(i)%stiffness = sizes(kept(i))
      springs(i)%kernel = kernel
    end do
  end subroutine finish_layer

end module viscovib_layer_groups
